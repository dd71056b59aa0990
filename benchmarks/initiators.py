"""Speed of the initiators: batched JAX on all cores against NumPy on one pinned core.

Compile and run apart, same data, ratios of one process run. `make bench`, or with names:
`python benchmarks/initiators.py standard improved`.
"""

import os
import sys
import time

import jax

CORES = sorted(os.sched_getaffinity(0))
jax.config.update("jax_num_cpu_devices", len(CORES))

import jax.numpy as jnp  # noqa: E402
import numpy as np  # noqa: E402
import peers  # noqa: E402

from jaxtrack.hough import Grid, Sizes, improved, joint, modified, neutrosophic, standard  # noqa: E402
from jaxtrack.models import PositionSensor  # noqa: E402
from jaxtrack.montecarlo import monte_carlo  # noqa: E402
from jaxtrack.sensors import crossing_targets, observe, radar_measurements  # noqa: E402

LINES, SEPARATION, SEED = 6, (102.0, 0.1003), 0
GRID = {"rho_max": 4000.0, "n_rho": 1600, "n_theta": 3142}
PAPER_S = {"standard": 4.0209, "neutrosophic": 0.1330, "modified": 0.0637, "improved": 0.0518}
AREA_M2 = 3500.0 * 1600.0


def shapes(clutter):
    if clutter > 20:
        return 96, Sizes(lines=LINES, pairs=1536, predecessors=40, candidates=64)
    return 32, Sizes(lines=LINES, pairs=192, predecessors=20, candidates=64)


def methods(sizes, all_pairs):
    """Name → estimate; the voting methods with their raw own-cell votes, as their peers have."""
    rules = neutrosophic.Rules(landing="own_cell")
    return {
        "standard": lambda s: standard.estimate(s, standard.StandardParams(), sizes=sizes)[0],
        "modified": lambda s: modified.estimate(s, modified.ModifiedParams(), sizes=all_pairs)[0],
        "improved": lambda s: improved.estimate(s, improved.ImprovedParams(), sizes=sizes)[0],
        "neutrosophic": lambda s: neutrosophic.estimate(
            s, neutrosophic.NeutrosophicParams(), sizes=sizes, rules=rules
        )[0],
    }


def batched_seconds(estimate, scene, detections, trials):
    """Return seconds to compile, and seconds a realization of simulation and estimation.

    The realizations of a core follow each other: several at a time would leave its cache.
    """

    def trial(key, scene):
        return estimate(observe(key, scene.truth, scene.radar, detections=detections))

    run = lambda: monte_carlo(trial, jax.random.key(SEED), trials, scene, micro_batch=1)
    begin = time.perf_counter()
    run()
    first = time.perf_counter() - begin
    times = []
    for _ in range(3):
        begin = time.perf_counter()
        run()  # results are NumPy arrays on the host: nothing is left in flight
        times.append(time.perf_counter() - begin)
    return max(first - min(times), 0.0), min(times) / trials


def drawn(scene, detections, runs):
    """The realizations that the batch sees, as lists of NumPy arrays of detections."""
    keys = jax.vmap(lambda t: jax.random.fold_in(jax.random.key(SEED), t))(
        jnp.arange(runs, dtype=jnp.uint32)
    )
    draw = jax.jit(
        jax.vmap(lambda key: observe(key, scene.truth, scene.radar, detections=detections))
    )
    scans = jax.tree.map(np.asarray, draw(keys))
    return [
        [scans.position_m[r, k][scans.mask[r, k]] for k in range(scans.mask.shape[1])]
        for r in range(runs)
    ]


def numpy_seconds(peer, data):
    """Median seconds a realization of a peer, pinned to one core."""
    os.sched_setaffinity(0, {CORES[0]})
    try:
        times = []
        for scans in data:
            begin = time.perf_counter()
            peer(scans)
            times.append(time.perf_counter() - begin)
        return float(np.median(times))
    finally:
        os.sched_setaffinity(0, set(CORES))


def numpy_peers():
    gate = {"dt": 2.0, "v_min": 100.0, "v_max": 400.0}
    common = dict(**GRID, lines=LINES, separation=SEPARATION)
    return {
        "standard": lambda s: peers.standard(s, **common),
        "improved": lambda s: peers.improved(s, **gate, **common),
        "neutrosophic": lambda s: peers.neutrosophic(
            s, **gate, eps=(20.0, 0.004), p_false=0.01, p_gate=0.99, sigma=10.0, **common
        ),
    }


def main(names):
    print(
        f"jax {jax.__version__}, numpy {np.__version__}, {len(jax.devices())} CPU devices, "
        f"NumPy pinned to one core, seed {SEED}; simulation is counted with ours, not with NumPy"
    )
    print(
        f"{'method':14}{'clutter':>8}{'trials':>8}{'compile s':>11}{'ours ms':>10}"
        f"{'NumPy ms':>10}{'ratio':>8}{'aim':>6}"
    )
    aims = {"standard": 5, "improved": 20, "neutrosophic": 20}
    for clutter in (10.0, 56.0):
        detections, sizes = shapes(clutter)
        all_pairs = sizes._replace(pairs=detections**2)
        scene = crossing_targets("IV", clutter)
        data = drawn(scene, detections, 64)
        for name, peer in numpy_peers().items():
            if names and name not in names:
                continue
            estimate = methods(sizes, all_pairs)[name]
            compile_s, ours = batched_seconds(estimate, scene, detections, 1024)
            theirs = numpy_seconds(peer, data)
            print(
                f"{name:14}{clutter:8.0f}{1024:8d}{compile_s:11.1f}{ours * 1e3:10.3f}"
                f"{theirs * 1e3:10.2f}{theirs / ours:8.1f}{aims[name]:6d}",
                flush=True,
            )
    if not names or "joint" in names:
        for clutter in (10.0, 56.0):
            detections, _ = shapes(clutter)
            params = joint.JointParams(PositionSensor(0.99, clutter / AREA_M2, 10.0))
            sizes = joint.JointSizes(hypotheses=32768 if clutter > 20 else 4096)
            scene = crossing_targets("IV", clutter)
            compile_s, ours = batched_seconds(
                lambda s, p=params, z=sizes: joint.lines_of(joint.estimate(s, p, sizes=z)[0]),
                scene, detections, 1024,
            )  # fmt: skip
            print(
                f"{'joint':14}{clutter:8.0f}{1024:8d}{compile_s:11.1f}{ours * 1e3:10.3f}"
                "   at 56 at most 50 ms",
                flush=True,
            )
    print("\nreal radar data, 10 clutter a scan: ours a run beside the paper's time a run")
    scene = radar_measurements()
    sizes = Sizes(lines=LINES, pairs=96, predecessors=20, candidates=64, rho=6800)
    grid = Grid(origin_m=(-12500.0, 21000.0), rho_max_m=17000.0)
    rules = neutrosophic.Rules(landing="own_cell")
    real = {
        "standard": lambda s: standard.estimate(s, standard.StandardParams(grid), sizes=sizes)[0],
        "modified": lambda s: modified.estimate(
            s, modified.ModifiedParams(grid), sizes=sizes._replace(pairs=1024)
        )[0],
        "improved": lambda s: improved.estimate(s, improved.ImprovedParams(grid), sizes=sizes)[0],
        "neutrosophic": lambda s: neutrosophic.estimate(
            s, neutrosophic.NeutrosophicParams(grid), sizes=sizes, rules=rules
        )[0],
    }
    for name, estimate in real.items():
        if names and name not in names:
            continue
        trials = 128 if name == "standard" else 4096
        compile_s, ours = batched_seconds(estimate, scene, 32, trials)
        print(
            f"{name:14}{10:8d}{trials:8d}{compile_s:11.1f}{ours * 1e3:10.3f}"
            f"{PAPER_S[name] * 1e3:10.1f}{PAPER_S[name] / ours:8.0f}",
            flush=True,
        )


if __name__ == "__main__":
    main(sys.argv[1:])
