"""The search that the defaults of `ClusteringParams` come from, on scenes other than the paper's.

Windows of 20 looks, P_M = P_F = 0.3, at most one false alarm a look, σ = 3 m; straight targets
drawn over the sector of the paper's vehicle, three in most scenes, else one, two or four. An
evolution: each generation draws new scenes and multiplies the parameters of the best so far by
log-normal factors. At the end of a stage the first and the last winners are compared on 2048 scenes
that none of them has seen. The second stage starts from the best of the first, with factors half as
wide.

These scenes are mixed: about 769 are fair and have three targets. The best of the winners is chosen
on the same scenes that its shares are printed of, which flatters them: an independent number needs
another seed, or other scenes.
"""

import argparse
import os
from typing import NamedTuple

import jax

jax.config.update("jax_num_cpu_devices", len(os.sched_getaffinity(0)))

import jax.numpy as jnp  # noqa: E402
import numpy as np  # noqa: E402

from jaxtrack.clustering import IsodataParams  # noqa: E402
from jaxtrack.hough import pack_beams  # noqa: E402
from jaxtrack.hough.clustering_statistic import ClusteringParams, estimate  # noqa: E402
from jaxtrack.hough.slope_intercept import LineGrid  # noqa: E402
from jaxtrack.metrics import ospa  # noqa: E402
from jaxtrack.models import polar_to_earth, propagate  # noqa: E402
from jaxtrack.montecarlo import monte_carlo  # noqa: E402
from jaxtrack.sensors import in_sight, motion_elements_scene, observe_beams  # noqa: E402
from jaxtrack.types import Truth  # noqa: E402

MOST, SHARES = 4, (0.08, 0.12, 0.70, 0.10)  # targets, and how often there are 1, 2, 3, 4
CHILDREN, FINALISTS, FINAL_SCENES = 24, 6, 2048


class Stage(NamedTuple):
    """One evolution."""

    start: ClusteringParams
    seed: int
    generations: int
    scenes: int  # of a generation
    spread: float  # of the factors' logarithms


def params(x, y, shares, cluster, isodata):
    """Return parameters with the ends of the grids that all of them have."""
    grids = LineGrid(-9.8, x[0], -49.7, x[1]), LineGrid(-6.0, y[0], -40.0, y[1])
    return ClusteringParams(*grids, *shares, *cluster, IsodataParams(*isodata))


BY_HAND = params(
    (0.245, 5.0), (0.15, 4.0), (0.55, 0.59), (7.1, 3.35), (2.12, 0.17, 2.4, 0.2, 0.54, 0.7, 0.08)
)
# What the first stage finds, rounded.
FIRST = params(
    (0.2094, 6.63),
    (0.1464, 6.2),
    (0.504, 0.615),
    (4.783, 2.06),
    (2.452, 0.16, 3.396, 0.2, 0.403, 0.484, 0.0515),
)
STAGES = Stage(BY_HAND, 0, 30, 256, 0.12), Stage(FIRST, 1, 14, 768, 0.06)


def random_scene(key):
    """Return a scene of the paper's vehicle with other targets, and whether it is a fair one."""
    scene = motion_elements_scene()
    time_s, middle = scene.truth.time_s, scene.truth.time_s[-1] / 2
    number, *draws = jax.random.split(key, 5)
    pose = jax.tree.map(lambda x: x[len(time_s) // 2], scene.pose)
    draw = lambda key, low, high: jax.random.uniform(key, (MOST,), minval=low, maxval=high)
    half = scene.sonar.sector_rad / 2
    range_m = jnp.sqrt(draw(draws[0], 10.0**2, scene.sonar.range_max_m**2))
    place = polar_to_earth(range_m, draw(draws[1], -half, half), pose, scene.sonar.mount_m)
    speed, course = draw(draws[2], 0.5, 6.0), draw(draws[3], 0.0, 2 * jnp.pi)
    velocity = speed[:, None] * jnp.stack([jnp.cos(course), jnp.sin(course)], -1)
    state = jnp.concatenate([place - middle * velocity, velocity], -1)
    path = jax.vmap(propagate, (None, 0))(state, time_s)
    count = jax.random.choice(number, MOST, p=jnp.array(SHARES)) + 1
    here = jnp.arange(MOST) < count
    truth = Truth(time_s, path, jnp.broadcast_to(here, (len(time_s), MOST)))
    seen = in_sight(truth, scene.pose, scene.sonar).mask.mean(0)
    # The vote sees one coordinate: two targets must differ in it, by speed or at one end.
    apart = jnp.abs(velocity[:, None, 0] - velocity[None, :, 0]) >= 2.0
    for end in (path[0], path[-1]):
        apart |= jnp.abs(end[:, None, 0] - end[None, :, 0]) >= 15.0
    apart |= ~(here[:, None] & here[None]) | jnp.eye(MOST, dtype=bool)
    return scene._replace(truth=truth), apart.all() & ((seen >= 0.75) | ~here).all(), count


def trial(key, params):
    """Return position OSPA of order 2, whether the number is exact, targets, fairness."""
    draw, look = jax.random.split(key)
    scene, fair, count = random_scene(draw)
    scans = observe_beams(look, *scene, beams=90, false_alarms="per_scan")
    tracks, _ = estimate(pack_beams(scans, scene.sonar, 8)[0], params)
    truth, there = scene.truth.state[-1, :, :2], scene.truth.mask[-1]
    error = ospa(tracks.mean[:, :2], tracks.mask, truth, there, cutoff=20.0, order=2.0).distance
    return error, tracks.mask.sum() == count, count, fair


def evaluate(key, candidates, scenes):
    """Return for each set of parameters: score, share exact and median with three, by number."""
    stacked = jax.tree.map(lambda *x: jnp.stack(x), *candidates)
    run = monte_carlo(trial, key, scenes, stacked, micro_batch=8, batch_params=True)
    error, exact, count, fair = map(np.asarray, run.values)
    rows = []
    for e, x, c, f in zip(error, exact, count, fair, strict=True):
        three = f & (c == 3)
        shares = [x[f & (c == n)].mean() for n in range(1, MOST + 1)]
        median = np.median(e[three])
        rows.append((median + 20 * (1 - x[three].mean()) + e[three].mean() / 4, shares, median))
    return rows


def vary(rng, params, spread):
    """Return parameters times log-normal factors; the grids' ends stay, shares below one."""
    leaves, structure = jax.tree.flatten(params)
    factor = np.exp(spread * rng.normal(size=len(leaves)) * (rng.random(len(leaves)) < 0.4))
    names = [path[-1].name for path, _ in jax.tree_util.tree_leaves_with_path(params)]
    kept = ("velocity_min_m_s", "position_min_m", "sigma_m")
    new = []
    for name, leaf, by in zip(names, leaves, factor, strict=True):
        value = leaf if name in kept else leaf * by
        new.append(jnp.minimum(value, 0.95) if name in ("cell_share", "line_share") else value)
    return structure.unflatten(new)


def evolve(stage):
    """Return the best of the first and the last winners of a stage, to four digits."""
    rng, key = np.random.default_rng(stage.seed), jax.random.key(stage.seed)
    best = jax.tree.map(jnp.asarray, stage.start)
    winners = [best]
    print(f"{stage}, {CHILDREN} candidates a generation")
    for generation in range(stage.generations):
        candidates = [best, *(vary(rng, best, stage.spread) for _ in range(CHILDREN - 1))]
        rows = evaluate(jax.random.fold_in(key, generation), candidates, stage.scenes)
        place = int(np.argmin([row[0] for row in rows]))
        if place:
            best = candidates[place]
            winners.append(best)
        print(f"{generation:3d} {in_words(rows[place])}", flush=True)
    finalists = [winners[0], *winners[1:][-FINALISTS:]]
    rows = evaluate(jax.random.fold_in(key, 10**6), finalists, FINAL_SCENES)
    finalists = [jax.tree.map(lambda x: float(f"{float(x):.4g}"), each) for each in finalists]
    for each, row in zip(finalists, rows, strict=True):
        print(f"{in_words(row)}\n    {each}", flush=True)
    return finalists[int(np.argmin([row[0] for row in rows]))]


def in_words(row):
    """Return what `evaluate` found of one set of parameters."""
    score, shares, median = row
    exact = " ".join(f"{share:.3f}" for share in shares)
    return f"score {score:.3f}, exact {exact}, median {median:.3f} m"


def main():
    """Run the stages, print what each finds, and the defaults."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--generations", type=int, help="of each stage, for a quick look")
    options = parser.parse_args()
    for stage in STAGES:
        few = stage._replace(generations=options.generations or stage.generations)
        print(f"found:    {evolve(few)}\n")
    print(f"defaults: {ClusteringParams()}")


if __name__ == "__main__":
    main()
