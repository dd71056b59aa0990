"""Everything in float32, as users without x64 run it: a process of its own, warnings are errors.

Run as a script, this file is that process.
"""

import functools
import json
import os
import pathlib
import subprocess
import sys

import jax
import jax.numpy as jnp
import numpy as np

from jaxtrack import hough, metrics, montecarlo, sensors, tracking
from jaxtrack.models import BeamSonar, PositionSensor
from jaxtrack.types import Lines

CLUTTER = 10.0
SIZES = hough.Sizes(lines=6, pairs=192, candidates=64, rho=400, theta=628, smooth=2)
GRID = hough.Grid((1750.0, 800.0), 2000.0)
JOINT = hough.joint.JointSizes(hypotheses=4096)


def estimators(scans):
    """Return what each estimator gives for one set of looks, compiled."""
    speed, peaks = hough.SpeedGate(), hough.Peaks()
    standard = hough.standard.StandardParams(GRID, peaks)
    modified = hough.modified.ModifiedParams(GRID, peaks)
    neutrosophic = hough.neutrosophic.NeutrosophicParams(GRID, peaks, speed)
    sensor = PositionSensor(0.99, CLUTTER / (3500.0 * 1600.0), 10.0)
    joint = hough.joint.JointParams(sensor, speed, 15.0)
    eps = 20.0, 0.01
    runs = {
        "standard": (hough.standard.estimate, SIZES, standard),
        "modified, soft": (hough.modified.soft_estimate, SIZES, modified, *eps),
        "neutrosophic": (hough.neutrosophic.estimate, SIZES, neutrosophic),
        "neutrosophic, soft": (hough.neutrosophic.soft_estimate, SIZES, neutrosophic, 1.0),
        "joint": (hough.joint.estimate, JOINT, joint),
    }
    return {
        name: jax.jit(functools.partial(method, sizes=sizes))(scans, *params)
        for name, (method, sizes, *params) in runs.items()
    }


def trial(key, initial):
    truth = sensors.move(key, initial, 2.0 * jnp.arange(7.0))
    radar = sensors.Radar(clutter_per_scan=CLUTTER)
    scans = sensors.observe(key, truth, radar, detections=32)
    params = hough.improved.ImprovedParams(GRID)
    lines, _ = hough.improved.estimate(scans, params, sizes=SIZES)
    position = jnp.moveaxis(truth.state[..., :2], 0, 1)
    scores = metrics.initiation_scores(lines, position, truth.mask.all(0), match_m=50.0, gate=3.0)
    return scores, truth.state


def sonar_looks(key, truth):
    """Return the paper's and a random scene, what the sonar makes of them, and positions."""
    scenes = (
        sensors.motion_elements_scene(),
        sensors.tracking_scene(truth),
        sensors.random_sonar_scene(key, BeamSonar(), sensors.SonarSceneLimits(), targets=3)[0],
    )
    looks = []
    for scene, false_alarms in zip(scenes, ("per_beam", "per_scan", "per_beam"), strict=True):
        scans = sensors.observe_beams(
            key, *scene, false_alarms=false_alarms, echo=sensors.Echo(), beams=30
        )
        looks.append((scans, jax.vmap(sensors.scan_of_beams, (0, None))(scans, scene.sonar)))
    return [(scene.truth, scene.pose) for scene in scenes], looks


def report():
    """Run everything; return what went wrong, and what the joint vote found."""
    wrong = []

    def check(name, tree):
        for path, leaf in jax.tree.leaves_with_path(tree):
            leaf = jnp.asarray(leaf)
            where = name + jax.tree_util.keystr(path)
            if jnp.issubdtype(leaf.dtype, jnp.floating):
                if leaf.dtype != jnp.float32:
                    wrong.append(f"{where}: {leaf.dtype}")
                # Scores of candidates that do not exist are −∞ by definition.
                bad = jnp.isnan(leaf) if "hypothesis" in where else ~jnp.isfinite(leaf)
                if bad.any():
                    wrong.append(f"{where}: not finite")
            elif leaf.dtype.itemsize > 4:
                wrong.append(f"{where}: {leaf.dtype}")

    scene = sensors.crossing_targets("IV", CLUTTER)
    scans = sensors.observe(jax.random.key(7), scene.truth, scene.radar, detections=32)
    check("scans", scans)
    looks = jax.jit(functools.partial(sonar_looks, truth="visible"))(jax.random.key(9))
    check("sonar", looks)
    found = estimators(scans)
    for name, result in found.items():
        check(name, result)
    tracks, _ = found["joint"]
    lines = hough.joint.lines_of(tracks)
    started = jax.jit(tracking.initiate)(scans, lines, tracking.InitiateParams())
    check("initiate", (lines, started))

    truth = scene.truth.state[-1, :, :2]
    sets = tracks.mean[:, :2], tracks.mask, truth, scene.truth.mask[-1]
    distance = jax.jit(functools.partial(metrics.ospa, cutoff=100.0, order=2.0))
    ospa, smoothed = distance(*sets), distance(started[0].mean[:, :2], started[0].mask, *sets[2:])
    gospa = jax.jit(functools.partial(metrics.gospa, cutoff=100.0, order=2.0))(*sets)
    check("metrics", (ospa, smoothed, gospa))
    run = montecarlo.monte_carlo(trial, jax.random.key(8), 8, scene.truth.state[0], micro_batch=4)
    check("monte_carlo", (run.values, run.mean, run.standard_error))
    return {
        "wrong": wrong,
        "lines": {
            name: int(result.mask.sum())
            for name, (result, _) in found.items()
            if isinstance(result, Lines)
        },
        "tracks": int(tracks.mask.sum()),
        "ospa_m": float(ospa.distance),
        "smoothed_ospa_m": float(smoothed.distance),
    }


def test_everything_works_in_float32():
    root = pathlib.Path(__file__).resolve().parent.parent
    options = {
        "JAX_ENABLE_X64": "0",
        "JAX_NUMPY_RANK_PROMOTION": "raise",
        "JAX_NUMPY_DTYPE_PROMOTION": "strict",
        "JAX_COMPILATION_CACHE_DIR": str(root / ".jax_cache"),
        "JAX_PERSISTENT_CACHE_MIN_COMPILE_TIME_SECS": "0",
        "JAX_PLATFORMS": "cpu",
    }
    run = subprocess.run(
        [sys.executable, "-W", "error", __file__],
        cwd=root,
        env=os.environ | options,
        capture_output=True,
        text=True,
        check=False,
    )
    assert run.returncode == 0, run.stderr
    seen = json.loads(run.stdout)
    assert seen["wrong"] == []
    assert len(seen["lines"]) == 4
    assert all(count > 0 for count in seen["lines"].values())
    assert seen["tracks"] == 3
    assert seen["ospa_m"] < 20.0
    assert seen["smoothed_ospa_m"] < 20.0


if __name__ == "__main__":
    assert not jax.config.jax_enable_x64
    assert np.asarray(jnp.zeros(1)).dtype == np.float32
    sys.stdout.write(json.dumps(report()))
