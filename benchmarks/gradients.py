"""Gradients through 200 looks of a tracker: what they cost, and whether they blow up or vanish.

The loss is read off the tracks of all looks, or of the last one alone; its gradient is in the
detections of every look and in the tracker's numbers. Memory is what the compiled program asks for
beside its arguments. Gradients go by `scan_in_segments`. Everything is in double precision, on one
core as a rule. `make bench`.
"""

import functools
import pathlib
import sys
import time

import jax

jax.config.update("jax_enable_x64", True)
sys.path.append(str(pathlib.Path(__file__).parents[1]))  # for the model of the tests

import jax.numpy as jnp  # noqa: E402
import numpy as np  # noqa: E402

from jaxtrack.filtering.resampling import soft  # noqa: E402
from jaxtrack.numerics import scan_in_segments  # noqa: E402
from jaxtrack.sensors import Radar, move, observe  # noqa: E402
from jaxtrack.tracking import KalmanTrackerParams, kalman_tracker  # noqa: E402
from jaxtrack.types import Stage  # noqa: E402
from tests.filtering.linear_gaussian import MODEL, Model, build, looks  # noqa: E402

LOOKS, SLOTS, PLACES, SIDE_M = 200, 8, 12, 200.0
RADAR = Radar(0.9, 1.0, 2.0, (0.0, 0.0), (SIDE_M, SIDE_M))
START = ((20.0, 20.0, 0.5, 0.4), (180.0, 30.0, -0.4, 0.5), (20.0, 180.0, 0.6, -0.3))
NUMBERS = (1.0, 0.1, 0.9, 1e-4)  # σ, σ_a, P_D, clutter
TRUTH = move(jax.random.key(0), jnp.asarray(START), jnp.arange(float(LOOKS)))
SCANS = observe(jax.random.key(1), TRUTH, RADAR, detections=PLACES)
PARTICLES = 256
SCANNERS = scan_in_segments, jax.lax.scan
AIM_TIME, AIM_MEMORY = 4.0, 3.0


def tracks(associator, scan, numbers, position_m):
    tracker = kalman_tracker(KalmanTrackerParams(*numbers), max_tracks=SLOTS, associator=associator)
    start = tracker.init(jax.random.key(0))
    return scan(tracker.step, start, SCANS._replace(position_m=position_m))[1]


def nearness(tracks, truth):
    """Return how near confirmed tracks are to targets, look by look, [T]."""
    there = tracks.stage >= Stage.CONFIRMED
    squared = ((tracks.mean[:, :, None, :2] - truth.state[:, None, :, :2]) ** 2).sum(-1)
    return jnp.where(there[..., None], jnp.exp(-squared / 8), 0.0).sum((1, 2))


def kalman_loss(associator, scan, last, numbers, position_m):
    near = nearness(tracks(associator, scan, numbers, position_m).tracks, TRUTH)
    return near[-1] if last else near.mean()


def particle_loss(scan, last, numbers, z):
    """Return the particle filter's squared error: mean, or at the end."""
    model = Model(*numbers)
    filter = build(model, soft(mix=0.5), particles=PARTICLES, scored=False)
    _, info = scan(filter.step, filter.init(jax.random.key(0)), z)
    squared = (info.mean[:, 0] - z) ** 2
    return squared[-1] if last else squared.mean()


def measured(*functions, repeats=15):
    """Return seconds and megabytes of compiled functions, which take turns."""
    programs = [jax.jit(f).lower(*a).compile() for f, *a in functions]
    arguments = [a for _, *a in functions]
    best = [np.inf] * len(programs)
    for _ in range(repeats):
        for n, program in enumerate(programs):
            begin = time.perf_counter()
            jax.block_until_ready(program(*arguments[n]))
            best[n] = min(best[n], time.perf_counter() - begin)
    sizes = [program.memory_analysis() for program in programs]
    return best, [(s.temp_size_in_bytes + s.output_size_in_bytes) / 1e6 for s in sizes]


def runs():
    """Yield names, losses `(scan, last, numbers, detections)`, runs with infos, and where."""
    for associator in ("greedy", "optimal", "jpda", "belief_propagation", "pmht"):
        loss = functools.partial(kalman_loss, associator)
        infos = functools.partial(tracks, associator, jax.lax.scan)
        yield f"Kalman, {associator}", loss, infos, (jnp.asarray(NUMBERS), SCANS.position_m)

    def run(numbers, z):
        filter = build(Model(*numbers), soft(mix=0.5), particles=PARTICLES, scored=False)
        return jax.lax.scan(filter.step, filter.init(jax.random.key(0)), z)[1]

    z = jnp.asarray(looks(0, LOOKS))
    yield "particles, soft resampling", particle_loss, run, (jnp.asarray(MODEL), z)


def cost():
    print(
        f"\n{LOOKS} looks; the Kalman trackers have {SLOTS} slots and {PLACES} places; gradient in "
        f"detections and numbers\n"
        f"{'':28}{'ms forward':>11}{'gradient':>10}{'ratio':>7}{'aim':>5}{'MB forward':>12}"
        f"{'with infos':>12}{'gradient':>10}{'ratios':>12}{'aim':>5}{'plain scan':>12}"
    )
    for name, loss, infos, at in runs():
        segmented, plain = (functools.partial(loss, scan, False) for scan in SCANNERS)
        (forward, back, _, _), (small, needed, whole, more) = measured(
            (plain, *at),
            (jax.grad(segmented, (0, 1)), *at),
            (infos, *at),
            (jax.grad(plain, (0, 1)), *at),
        )
        ratios = f"{needed / small:.1f}, {needed / whole:.1f}"
        print(
            f"{name:28}{1e3 * forward:11.1f}{1e3 * back:10.1f}{back / forward:7.2f}{AIM_TIME:5.0f}"
            f"{small:12.3f}{whole:12.3f}{needed:10.3f}{ratios:>12}{AIM_MEMORY:5.0f}{more:12.1f}"
        )


def norms():
    ago = (0, 10, 50, 100, 150, 190)
    print(
        "\nnorm of the gradient in the detections, the largest of five looks, by how many looks "
        "before the end;\nof a mean over all looks, and of the last look alone\n"
        f"{'':40}" + "".join(f"{n:>9}" for n in ago) + f"{'numbers':>9}"
    )
    for name, loss, _, at in runs():
        for last, what in ((False, "all"), (True, "last")):
            of = functools.partial(loss, scan_in_segments, last)
            numbers, by_look = jax.jit(jax.grad(of, (0, 1)))(*at)
            by_look = np.linalg.norm(np.asarray(by_look).reshape(LOOKS, -1), axis=1)
            around = [by_look[max(LOOKS - n - 5, 0) : LOOKS - n].max() for n in ago]
            values = "".join(f"{x:9.0e}" for x in (*around, np.linalg.norm(numbers)))
            print(f"{name + ', ' + what:40}{values}")


if __name__ == "__main__":
    cost()
    norms()
