"""Speed of Zernike moments around the particles of a tracker, against a loop over mahotas.

Ours on all cores, compile and run apart; mahotas on one pinned core, given the whole image and the
place of each particle, and given an image cut out around each, which spares it most of its work.
Clouds stand on a lattice, so that moments have to be the same.
`make bench`, or with names: `python benchmarks/moments.py forward gradient`.
"""

import os
import sys
import time

import jax

CORES = sorted(os.sched_getaffinity(0))
jax.config.update("jax_num_cpu_devices", len(CORES))

import mahotas  # noqa: E402
import numpy as np  # noqa: E402
from mahotas.features import zernike_moments  # noqa: E402

from jaxtrack.moments import PAPER_ORDERS, soft_zernike, windowed, zernike  # noqa: E402

SEED, BATCH, PARTICLES, POINTS, PLACES = 0, 256, 120, 512, 96
RADIUS_M, CELL_M, SPREAD_M = 1.0, 0.0625, 1.0  # the window's radius is 16 cells
FIELD_M = 16.0
TOGETHER = 8  # realizations under one vmap: more leave the cache
AIM_US, AIM_RATIO, AIM_GRADIENT = 100.0, 300, 4


def clouds():
    """Return points [B, P, 2], weights and particles: a target, a dike, echoes all over the field.

    Everything stands on the lattice; no two points on one place.
    """
    rng = np.random.default_rng(SEED)
    side = round(FIELD_M / CELL_M)
    places, particles = [], []
    for _ in range(BATCH):
        target = rng.normal(0.0, 0.35, (80, 2))
        dike = np.stack([rng.uniform(-8, 8, 400), 5.0 + rng.normal(0.0, 0.3, 400)], -1)
        over = rng.uniform(-8, 8, (400, 2))
        cell = np.round(np.concatenate([target, dike, over]) / CELL_M).astype(int)
        cell = cell[(np.abs(cell) < side // 2).all(-1)]
        _, first = np.unique(cell, axis=0, return_index=True)
        places.append(cell[np.sort(first)[:POINTS]] * CELL_M)
        particles.append(np.round(rng.normal(0.0, SPREAD_M, (PARTICLES, 2)) / CELL_M) * CELL_M)
    weight = rng.uniform(0.2, 1.0, (BATCH, POINTS))
    return tuple(np.asarray(x, np.float32) for x in (places, weight, particles))


def seconds(run, repeats=10):
    """Return seconds to compile, and seconds of the fastest of some calls."""
    times = []
    for _ in range(repeats + 1):
        begin = time.perf_counter()
        jax.block_until_ready(run())
        times.append(time.perf_counter() - begin)
    return max(times[0] - min(times[1:]), 0.0), min(times[1:])


def on_all_devices(one, data):
    """Return a call of a function of one realization on a batch, each core with its share."""
    mesh = jax.sharding.Mesh(np.array(jax.local_devices()), ("batch",))
    share = jax.sharding.PartitionSpec("batch")
    data = jax.device_put(data, jax.sharding.NamedSharding(mesh, share))
    body = lambda data: jax.lax.map(lambda at: one(*at), data, batch_size=TOGETHER)
    run = jax.jit(jax.shard_map(body, mesh=mesh, in_specs=share, out_specs=share, check_vma=False))
    return lambda: run(data)


def moments_of(xy, weight, particles):
    """Return the paper's moments about every particle, [N, 7], and whether all points fitted."""
    windows = windowed(xy, weight, particles, radius=RADIUS_M, most=PLACES)
    one = lambda xy, weight: zernike(xy, weight, orders=PAPER_ORDERS, radius=RADIUS_M)
    return jax.vmap(one)(windows.xy, windows.weight), windows.overflow


def loss(xy, weight, particles):
    """Return a sum of squares of soft moments."""
    windows = windowed(xy, weight, particles, radius=RADIUS_M, most=PLACES)
    one = lambda xy, weight: soft_zernike(
        xy, weight, orders=PAPER_ORDERS, radius=RADIUS_M, taper=0.2
    )
    found = jax.vmap(one)(windows.xy, windows.weight)
    return (found.real**2 + found.imag**2).sum()


def mahotas_magnitudes(xy, weight, particles, *, cut):
    """Return |Z| of all orders to 9 about every particle, [N, 30]."""
    reach, side = round(RADIUS_M / CELL_M), round(FIELD_M / CELL_M)
    image = np.zeros((side + 2 * reach, side + 2 * reach))
    column, row = (np.round(xy / CELL_M).astype(int) + side // 2 + reach).T
    image[row, column] = weight
    found = []
    for x, y in np.round(particles / CELL_M).astype(int) + side // 2 + reach:
        around = image[y - reach : y + reach + 1, x - reach : x + reach + 1]
        if not around.any():  # mahotas would divide by no mass
            found.append(np.zeros(30))
        elif cut:
            found.append(zernike_moments(around, reach, degree=9, cm=(reach, reach)))
        else:
            found.append(zernike_moments(image, reach, degree=9, cm=(y, x)))
    return np.array(found)


def pinned(run):
    """Return seconds of one call on one pinned core, and what it gave."""
    os.sched_setaffinity(0, {CORES[0]})
    try:
        begin = time.perf_counter()
        found = run()
        return time.perf_counter() - begin, found
    finally:
        os.sched_setaffinity(0, set(CORES))


def forward():
    data = clouds()
    run = on_all_devices(moments_of, data)
    compile_s, run_s = seconds(run)
    found, overflow = (np.asarray(x) for x in run())
    every = [(n, m) for n in range(10) for m in range(n % 2, n + 1, 2)]
    columns = [every.index(order) for order in PAPER_ORDERS]
    theirs, apart = {}, 0.0
    for cut, runs in ((True, 8), (False, 2)):
        times = []
        for n in range(runs):
            once, magnitudes = pinned(
                lambda n=n, cut=cut: mahotas_magnitudes(*(x[n] for x in data), cut=cut)
            )
            times.append(once)
            apart = max(apart, np.abs(np.abs(found[n]) - magnitudes[:, columns]).max())
        theirs[cut] = min(times)
    each = run_s / BATCH
    near = np.linalg.norm(data[0][:, :, None] - data[2][:, None], axis=-1) <= RADIUS_M
    orders = len(PAPER_ORDERS)
    print(
        f"\n{orders} moments about {PARTICLES} particles, {POINTS} points, {BATCH} runs\n"
        f"up to {near.any(2).sum(1).max()} points near any particle, {near.sum(1).mean():.0f} near "
        f"one on average, {PLACES} places, {overflow.sum()} runs overflow\n"
        f"ours     compile {compile_s:5.1f} s   {each * 1e6:7.1f} us a run and frame, "
        f"aim {AIM_US:.0f}\nmahotas, whole image {theirs[False] * 1e3:6.1f} ms: ours is "
        f"{theirs[False] / each:.0f} times as fast, aim {AIM_RATIO}\nmahotas, cut out     "
        f"{theirs[True] * 1e3:6.1f} ms: ours is {theirs[True] / each:.0f} times as fast, "
        f"aim {AIM_RATIO}\n"
        f"moments differ by {apart:.0e}",
        flush=True,
    )


def gradient():
    data = clouds()
    alone_s, alone = seconds(on_all_devices(loss, data))
    both_s, both = seconds(on_all_devices(jax.value_and_grad(loss, (0, 1, 2)), data))
    print(
        f"\nsum of squares of the same moments with a taper, by points, weights and particles\n"
        f"gradient compile {alone_s:.1f} and {both_s:.1f} s   forward {alone / BATCH * 1e6:.1f} us "
        f"a run and frame, with gradient {both / BATCH * 1e6:.1f}: {both / alone:.1f} times, "
        f"aim {AIM_GRADIENT}",
        flush=True,
    )


PARTS = {"forward": forward, "gradient": gradient}


def main(names):
    print(
        f"jax {jax.__version__}, mahotas {mahotas.__version__}, {len(jax.devices())} CPU devices, "
        f"seed {SEED}"
    )
    for name, part in PARTS.items():
        if not names or name in names:
            part()


if __name__ == "__main__":
    main(sys.argv[1:])
