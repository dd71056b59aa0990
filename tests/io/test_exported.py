"""Exported estimators run in a process that has JAX, and cannot import this library."""

import os
import subprocess
import sys

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from jaxtrack import io, models, sensors, tracking
from jaxtrack.hough import joint

# What a user writes on the other side; the library is barred there.
OTHER_SIDE = """
import sys
sys.modules["jaxtrack"] = None
import jax
import numpy as np

folder = sys.argv[1]
with open(f"{folder}/estimator.bin", "rb") as file:
    run = jax.export.deserialize(bytearray(file.read()))
arrays = dict(np.load(f"{folder}/arrays.npz"))
if sys.argv[2] == "once":
    found = run.call(arrays)
else:
    state = {name: x for name, x in arrays.items() if name.startswith("0.")}
    looks = {name: x for name, x in arrays.items() if name.startswith("1.")}
    for look in range(len(looks["1.time_s"])):
        found = run.call(state | {name: x[look] for name, x in looks.items()})
        state = {name: x for name, x in found.items() if name.startswith("0.")}
try:
    import jaxtrack
except ImportError:
    np.savez(f"{folder}/found.npz", **found)
"""


def elsewhere(folder, content, arrays, how):
    """Run an exported estimator on arrays in another process, and return what it finds."""
    (folder / "estimator.bin").write_bytes(content)
    np.savez(folder / "arrays.npz", **arrays)
    done = subprocess.run(
        [sys.executable, "-c", OTHER_SIDE, str(folder), how],
        env=os.environ | {"JAX_ENABLE_X64": "1"},
        cwd=folder,
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.returncode == 0, done.stderr
    return dict(np.load(folder / "found.npz"))


def looks_at_targets():
    scene = sensors.crossing_targets("II")
    return sensors.observe(jax.random.key(3), scene.truth, scene.radar, detections=4)


def test_a_window_estimator_gives_the_same_tracks(tmp_path):
    scans = looks_at_targets()
    sensor = models.PositionSensor(p_detect=0.99, clutter_per_m2=1e-7, sigma_m=10.0)
    sizes = joint.JointSizes(tracks=4, hypotheses=256, candidates=64, starts=4)

    def estimate(scans):
        return joint.estimate(scans, joint.JointParams(sensor, gate=8.0), sizes=sizes)[0]

    here = jax.jit(estimate)(scans)
    assert int(here.mask.sum()) == 3
    found = elsewhere(
        tmp_path, io.export_estimator(estimate, scans), io.named_arrays(scans), "once"
    )
    assert set(found) == set(here._fields)
    for name, value in here._asdict().items():
        np.testing.assert_allclose(found[name], value, rtol=1e-12, atol=1e-12)


@pytest.mark.slow
def test_a_tracker_exported_as_a_step_gives_the_same_tracks(tmp_path):
    scans = looks_at_targets()
    params = tracking.KalmanTrackerParams(10.0, 1.0, 0.99, 1e-9, birth_sigma_m_s=300.0)
    tracker = tracking.kalman_tracker(params, max_tracks=6)
    state = tracker.init(jax.random.key(0))
    first = jax.tree.map(lambda x: x[0], scans)
    here = jax.jit(lambda: jax.lax.scan(tracker.step, state, scans))()[1].tracks
    assert int(here.mask[-1].sum()) >= 3
    content = io.export_estimator(tracker.step, state, first)
    found = elsewhere(tmp_path, content, io.named_arrays(state, scans), "along")
    for name, value in here._asdict().items():
        np.testing.assert_allclose(found[f"1.tracks.{name}"], value[-1], rtol=1e-9, atol=1e-9)


def test_what_is_no_function_of_arrays_is_refused_by_name():
    with pytest.raises(TypeError, match="fn: got int"):
        io.export_estimator(3, jnp.ones(2))
    with pytest.raises(TypeError, match="like: got no arrays"):
        io.export_estimator(lambda: jnp.ones(2))


def test_other_shapes_than_those_exported_are_refused():
    run = jax.export.deserialize(bytearray(io.export_estimator(lambda x: x + 1, jnp.ones(2))))
    np.testing.assert_array_equal(run.call({"0": jnp.zeros(2)})[""], [1.0, 1.0])
    with pytest.raises(ValueError, match="shape"):
        run.call({"0": jnp.zeros(3)})
