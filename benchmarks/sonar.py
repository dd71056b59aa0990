"""Speed of the sonar's estimators: whole realizations, votes, clusters and a soft gradient.

Compile and run apart; baselines on one pinned core. `make bench`, or with names:
`python benchmarks/sonar.py votes cmeans`.
"""

import os
import sys
import time

import jax

CORES = sorted(os.sched_getaffinity(0))
jax.config.update("jax_num_cpu_devices", len(CORES))

import jax.numpy as jnp  # noqa: E402
import numpy as np  # noqa: E402
from scipy.special import ndtr  # noqa: E402

from jaxtrack.clustering import fuzzy_cmeans  # noqa: E402
from jaxtrack.hough import SpeedGate, clustering_statistic, joint, pack_beams  # noqa: E402
from jaxtrack.hough.slope_intercept import (  # noqa: E402
    LineGrid,
    LineSizes,
    Points,
    cell_centres,
    hard_votes,
    soft_votes,
)
from jaxtrack.metrics import ospa  # noqa: E402
from jaxtrack.models import BEAMS, BeamSensor  # noqa: E402
from jaxtrack.montecarlo import monte_carlo  # noqa: E402
from jaxtrack.sensors import motion_elements_scene, observe_beams  # noqa: E402

SEED, REALIZATIONS = 0, 4096
LOOKS, POINTS = 20, 8  # a window with one false alarm a look
SAMPLES, CLUSTERS, ROUNDS = 192, 3, 30
SPEED = SpeedGate(0.0, 6.0)
GATE = 9.0  # nats: that of the study csht_estimation at these rates
JOINT = joint.JointSizes(5, 16384, gap=10, survivors=4096, samples=256)


def seconds(run, repeats=5):
    """Return seconds of the first call, and of the fastest of some later ones."""
    times = []
    for _ in range(repeats + 1):
        begin = time.perf_counter()
        jax.block_until_ready(run())
        times.append(time.perf_counter() - begin)
    return times[0], min(times[1:])


def pinned_seconds(run, repeats=5):
    """Return the fastest of some calls, on one pinned core."""
    os.sched_setaffinity(0, {CORES[0]})
    try:
        return seconds(run, repeats)[1]
    finally:
        os.sched_setaffinity(0, set(CORES))


def on_all_devices(body, data):
    """Return a function of a batch compiled for all devices, and the batch spread over them."""
    mesh = jax.sharding.Mesh(np.array(jax.local_devices()), ("batch",))
    spread = jax.sharding.NamedSharding(mesh, jax.sharding.PartitionSpec("batch"))
    run = jax.shard_map(
        body, mesh=mesh, in_specs=spread.spec, out_specs=spread.spec, check_vma=False
    )
    return jax.jit(run), jax.device_put(data, spread)


def beams(key, false_alarms):
    scene = motion_elements_scene()
    return scene, observe_beams(key, *scene, beams=90, false_alarms=false_alarms)


def position_error(scene, tracks):
    truth, there = scene.truth.state[-1], scene.truth.mask[-1]
    return ospa(
        tracks.mean[:, :2], tracks.mask, truth[:, :2], there, cutoff=20.0, order=2.0
    ).distance


def csht_realization(key, params):
    scene, scans = beams(key, "per_scan")
    tracks, _ = clustering_statistic.estimate(pack_beams(scans, scene.sonar, POINTS)[0], params)
    return position_error(scene, tracks)


def joint_realization(key, gate):
    scene, scans = beams(key, "per_beam")
    params = joint.JointParams(BeamSensor(scene.sonar), SPEED, gate)
    return position_error(scene, joint.estimate(scans, params, sizes=JOINT, observation=BEAMS)[0])


def realizations():
    print(f"simulate, estimate and OSPA, {REALIZATIONS} realizations in one call, P_M = P_F = 0.3")
    aims = {"csht": 500, "joint": 200}
    runs = {
        "csht": (csht_realization, clustering_statistic.ClusteringParams()),
        "joint": (joint_realization, GATE),
    }
    for name, (trial, params) in runs.items():
        run = lambda trial=trial, params=params: (
            monte_carlo(trial, jax.random.key(SEED), REALIZATIONS, params, micro_batch=1).values
        )
        first, each = seconds(run, repeats=2)
        print(
            f"{name:8} compile {first - each:5.1f} s   {REALIZATIONS / each:7.0f} a second, "
            f"aim {aims[name]}   peak memory of the process {peak_gib():.2f} GiB",
            flush=True,
        )


def windows(count):
    """Windows of made-up points, [count, K, N]."""
    rng = np.random.default_rng(SEED)
    time_s = np.broadcast_to(np.arange(LOOKS)[:, None] / 2, (count, LOOKS, POINTS))
    position = rng.uniform(0.0, 150.0, time_s.shape)
    return Points(*(x.astype(np.float32) for x in (time_s, position, np.ones(time_s.shape))))


def bincount_votes(points, grid, sizes):
    """Hard votes of one window in NumPy."""
    velocity, _ = (np.asarray(x) for x in cell_centres(grid, sizes=sizes, dtype=np.float32))
    time_s, position, weight = (x.ravel() for x in points)
    place = position[None] - time_s[None] * velocity[:, None] - grid.position_min_m
    place = np.floor(place / grid.position_step_m).astype(np.int64)
    inside = (place >= 0) & (place < sizes.positions)
    cell = place + np.arange(sizes.velocities)[:, None] * sizes.positions
    weight = np.broadcast_to(weight[None], cell.shape)
    length = sizes.velocities * sizes.positions
    votes = np.bincount(cell[inside], weight[inside], minlength=length)
    return votes.reshape(sizes.velocities, sizes.positions)


def direct_votes(points, grid, sigma, sizes):
    """Soft votes of one window in NumPy: every vote's Gaussian in every cell of its row."""
    velocity, _ = (np.asarray(x) for x in cell_centres(grid, sizes=sizes, dtype=np.float32))
    time_s, position, weight = (x.ravel() for x in points)
    start = position[None] - time_s[None] * velocity[:, None]
    edge = grid.position_min_m + grid.position_step_m * np.arange(sizes.positions + 1)
    below = ndtr((edge[None, None] - start[..., None]) / np.float32(sigma))
    return (weight[None, :, None] * np.diff(below, axis=-1)).sum(1)


def votes():
    grid, sizes, sigma = LineGrid(), LineSizes(), 3.0
    many = 1024
    data = windows(many)
    print(
        f"\nvotes of {LOOKS * POINTS} points in {sizes.velocities} × {sizes.positions} cells, "
        f"{many} windows in one call; ours and NumPy each on all of them"
    )
    ours = {
        "hard": lambda points: hard_votes(points, grid, sizes=sizes),
        "soft": lambda points: soft_votes(points, grid, sigma, sizes=sizes),
    }
    theirs = {
        "hard": (lambda points: bincount_votes(points, grid, sizes), many, 3),
        "soft": (lambda points: direct_votes(points, grid, sigma, sizes), 64, 20),
    }
    alone = jax.device_put(data, jax.local_devices()[0])
    for name, vote in ours.items():
        body = lambda points, vote=vote: jax.lax.map(vote, points)
        everywhere, shared = on_all_devices(body, data)
        one_device = jax.jit(body)
        first, each = seconds(lambda run=everywhere, shared=shared: run(shared))
        single = pinned_seconds(lambda run=one_device: run(alone))
        peer, count, aim = theirs[name]
        some = [Points(*(x[w] for x in data)) for w in range(count)]
        numpy_s = pinned_seconds(lambda some=some, peer=peer: [peer(w) for w in some], 3) / count
        print(
            f"{name:8} compile {first - each:5.1f} s   {each / many * 1e3:7.3f} ms a window, "
            f"one core {single / many * 1e3:.3f}, NumPy {numpy_s * 1e3:.3f}: "
            f"{numpy_s * many / each:.1f} times as fast, one core {numpy_s * many / single:.1f}, "
            f"aim {aim}",
            flush=True,
        )


def cmeans():
    from skfuzzy.cluster import cmeans as peer

    many = 1024
    rng = np.random.default_rng(SEED)
    samples = rng.normal(size=(many, SAMPLES, 2)) + 5 * rng.integers(0, 3, (many, SAMPLES, 1))
    samples = samples.astype(np.float32)
    start = rng.normal(5.0, 4.0, (many, CLUSTERS, 2)).astype(np.float32)
    weights = jnp.ones(SAMPLES, jnp.float32)
    one = lambda x, z: fuzzy_cmeans(x, weights, z, tolerance=0.0, iterations=ROUNDS).centres
    body = lambda sets: jax.lax.map(lambda at: one(*at), sets, batch_size=32)
    run, data = on_all_devices(body, (samples, start))
    first, each = seconds(lambda: run(data))
    first_of = lambda w: peer(
        samples[w].T, CLUSTERS, 2.0, error=0.0, maxiter=ROUNDS, init=None, seed=SEED
    )
    theirs = pinned_seconds(lambda: [first_of(w) for w in range(32)], 3) / 32
    print(
        f"\nfuzzy c-means of {SAMPLES} samples, {CLUSTERS} clusters, {ROUNDS} iterations, {many} "
        f"sets\ncmeans   compile {first - each:5.1f} s   {each / many * 1e3:7.3f} ms a set, "
        f"scikit-fuzzy {theirs * 1e3:.2f}: {theirs * many / each:.0f} times as fast, aim 50",
        flush=True,
    )


def gradient():
    """A soft loss of the estimator, over 64 windows: forward, and with its gradient."""
    many = 64
    params = clustering_statistic.ClusteringParams()

    def window(key):
        scene, scans = beams(key, "per_scan")
        return pack_beams(scans, scene.sonar, POINTS)[0]

    keys = jax.random.split(jax.random.key(SEED), many)
    scans = jax.jit(jax.vmap(window))(keys)
    truth = motion_elements_scene().truth.state[-1]

    def loss(tolerance_m, params):
        def one(scan):
            tracks, _ = clustering_statistic.soft_estimate(scan, params, tolerance_m, 0.05)
            apart = ((tracks.mean[:, None] - truth[None]) ** 2).sum(-1)
            apart = jnp.where(tracks.mask[:, None], apart, 400.0)
            return jnp.minimum(apart.min(0), 400.0).sum()

        return jax.lax.map(one, scans).mean()

    forward = jax.jit(loss)
    backward = jax.jit(jax.value_and_grad(loss, argnums=(0, 1)))
    first, alone = seconds(lambda: forward(2.0, params))
    first_both, both = seconds(lambda: backward(2.0, params))
    print(
        f"\nsoft clustering-statistic loss of {many} windows\n"
        f"gradient compile {first - alone:.1f} and {first_both - both:.1f} s   forward "
        f"{alone / many * 1e3:.2f} ms a window, with gradient {both / many * 1e3:.2f}: "
        f"{both / alone:.1f} times, aim 4",
        flush=True,
    )


def peak_gib():
    with open("/proc/self/status") as status:
        kib = next(int(row.split()[1]) for row in status if row.startswith("VmHWM"))
    return kib / 2**20


PARTS = {"realizations": realizations, "votes": votes, "cmeans": cmeans, "gradient": gradient}


def main(names):
    print(
        f"jax {jax.__version__}, numpy {np.__version__}, {len(jax.devices())} CPU devices, "
        f"seed {SEED}"
    )
    for name, part in PARTS.items():
        if not names or name in names:
            part()


if __name__ == "__main__":
    main(sys.argv[1:])
