"""Speed of the Kalman trackers against Stone Soup, and of the filter against other JAX libraries.

Ours on all cores, compile and run apart; Stone Soup on one pinned core, set up as in the test that
has both agree to 1e-9. Everything is in double precision, as Stone Soup is. `make bench`, or with
names: `python benchmarks/trackers.py look run filter`.
"""

import datetime
import functools
import os
import pathlib
import sys
import time

import jax

CORES = sorted(os.sched_getaffinity(0))
jax.config.update("jax_num_cpu_devices", len(CORES))
jax.config.update("jax_enable_x64", True)
sys.path.append(str(pathlib.Path(__file__).parents[1]))  # for the peer that the tests check

import cuthbert  # noqa: E402
import jax.numpy as jnp  # noqa: E402
import numpy as np  # noqa: E402
from cuthbert.gaussian import kalman as square_root  # noqa: E402
from dynamax.linear_gaussian_ssm import inference as dynamax  # noqa: E402
from stonesoup.deleter.time import UpdateTimeStepsDeleter  # noqa: E402
from stonesoup.initiator.simple import MultiMeasurementInitiator  # noqa: E402
from stonesoup.tracker.simple import MultiTargetTracker  # noqa: E402
from stonesoup.types.state import GaussianState  # noqa: E402

from jaxtrack.association import (  # noqa: E402
    ASSOCIATORS,
    AssociationParams,
    predict_measurement,
)
from jaxtrack.filtering import gaussian  # noqa: E402
from jaxtrack.metrics import ospa_over_time  # noqa: E402
from jaxtrack.models.motion import propagate, transition_matrix  # noqa: E402
from jaxtrack.models.process import white_noise_acceleration  # noqa: E402
from jaxtrack.montecarlo import monte_carlo  # noqa: E402
from jaxtrack.sensors import Radar, move, observe  # noqa: E402
from jaxtrack.tracking import KalmanTrackerParams, kalman_tracker  # noqa: E402
from jaxtrack.types import Scan, Stage, Tracks, Truth  # noqa: E402
from tests.oracles import stone_soup  # noqa: E402

SEED, BATCH, TRACKS, DETECTIONS = 0, 1024, 5, 20
SIGMA, SIGMA_A, P_DETECT, GATE = 1.0, 0.1, 0.9, 9.21
AIMS = {"greedy": 200, "optimal": 200, "jpda": 2000}
SETTINGS = {"sigma": SIGMA, "sigma_a": SIGMA_A, "p_detect": P_DETECT, "gate": GATE}

TARGETS, CLUTTER, SCANS, RUNS, SLOTS, PLACES = 5, 10.0, 30, 1000, 48, 32
FIELD_M, SPEED_M_S, BIRTH_M_S, CUTOFF_M = 400.0, 3.0, 3.0, 20.0
TOGETHER = 8  # runs under one vmap: more leave the cache
RADAR = Radar(P_DETECT, SIGMA, CLUTTER, (0.0, 0.0), (FIELD_M, FIELD_M))


def seconds(run, repeats=7):
    """Return seconds to compile, and seconds of the fastest of some calls."""
    times = []
    for _ in range(repeats + 1):
        begin = time.perf_counter()
        jax.block_until_ready(run())
        times.append(time.perf_counter() - begin)
    return max(times[0] - min(times[1:]), 0.0), min(times[1:])


def over_cores(one, *batch):
    """Return a call of a function of one realization on a batch, each core with its share."""
    mesh = jax.sharding.Mesh(jax.devices(), ("core",))
    share = jax.P("core")
    batch = jax.device_put(batch, jax.sharding.NamedSharding(mesh, share))
    # Each its own: left to the partitioner, a batched decomposition may run on one core alone.
    each = jax.shard_map(jax.vmap(one), mesh=mesh, in_specs=share, out_specs=share, check_vma=False)
    return functools.partial(jax.jit(each), *batch)


def pinned(run):
    """Return seconds of one call on one pinned core, and what it gave."""
    os.sched_setaffinity(0, {CORES[0]})
    try:
        begin = time.perf_counter()
        found = run()
        return time.perf_counter() - begin, found
    finally:
        os.sched_setaffinity(0, set(CORES))


def batch_of_looks(field_m):
    """Return states [B, T, 4], covariances and places [B, N, 2]: each track once, and clutter."""
    rng = np.random.default_rng(SEED)
    mean = rng.uniform(0.0, field_m, (BATCH, TRACKS, 4))
    mean[..., 2:] = rng.uniform(-SPEED_M_S, SPEED_M_S, (BATCH, TRACKS, 2))
    covariance = np.broadcast_to(np.diag([1.0, 1.0, 0.5, 0.5]), (BATCH, TRACKS, 4, 4)).copy()
    places = rng.uniform(0.0, field_m, (BATCH, DETECTIONS, 2))
    noise = 1.5 * rng.normal(size=(BATCH, TRACKS, 2))
    places[:, :TRACKS] = mean[..., :2] + mean[..., 2:] + noise
    return mean, covariance, places


def our_look(name, clutter_per_m2, mean, covariance, places):
    """Predict by a second, associate and update the tracks of one realization."""
    dt = jnp.asarray(1.0)
    f, q = transition_matrix(dt), white_noise_acceleration(dt, SIGMA_A)
    mean = jax.vmap(propagate, (0, None))(mean, dt)
    covariance = jax.vmap(gaussian.predicted_covariance, (0, None, None))(covariance, f, q)
    predicted = predict_measurement(mean, covariance, SIGMA**2 * jnp.eye(2))
    scan = Scan(dt, jnp.asarray(True), places, jnp.ones(DETECTIONS, bool))
    associate, update, _ = ASSOCIATORS[name]
    found = associate(predicted, scan, AssociationParams(P_DETECT, clutter_per_m2, GATE))
    return update(mean, covariance, predicted, scan, found)


def stone_soup_look(name, clutter_per_m2, data, looks, found):
    """Return seconds a look, on average, and the largest difference from what ours found."""
    peer = stone_soup.Setup(name, clutter=clutter_per_m2, **SETTINGS)
    times, apart = [], 0.0
    for n in range(looks):
        mean, covariance, places = (x[n] for x in data)
        tracks = [stone_soup.track(*one, 0.0) for one in zip(mean, covariance, strict=True)]
        detections = peer.detections(places, 1.0)
        look = functools.partial(peer.look, set(tracks), detections, 1.0)
        times.append(pinned(look)[0])
        theirs = np.array([np.ravel(track.state.state_vector) for track in tracks], float)
        apart = max(apart, np.abs(theirs - found[0][n]).max())
    return float(np.mean(times)), apart


def look():
    print(
        f"\none look: predict, associate, update; {TRACKS} tracks, {DETECTIONS} detections, "
        f"batch {BATCH}\n{'field':>6}{'ours':>10}{'compile s':>11}{'us a look':>11}  "
        f"{'Stone Soup':12}{'looks':>6}{'ms a look':>11}{'ratio':>9}{'aim':>6}{'differ':>10}"
    )
    pairs = (("greedy", "nn"), ("optimal", "gnn"), ("jpda", "jpda"), ("jpda", "jpda_ehm2"))
    # The denser, the more joint events there are to enumerate.
    for field_m in (40.0, 20.0, 12.0):
        data = batch_of_looks(field_m)
        clutter = (DETECTIONS - TRACKS * P_DETECT) / field_m**2
        for ours, theirs in pairs:
            step = over_cores(functools.partial(our_look, ours, clutter), *data)
            compile_s, run_s = seconds(step)
            looks = 4 if (theirs, field_m) == ("jpda", 12.0) else 40
            their_s, apart = stone_soup_look(theirs, clutter, data, looks, step())
            aim = AIMS[ours] if theirs != "jpda_ehm2" else ""
            print(
                f"{field_m:4.0f} m{ours:>10}{compile_s:11.1f}{run_s / BATCH * 1e6:11.2f}  "
                f"{theirs:12}{looks:6d}{their_s * 1e3:11.1f}{their_s * BATCH / run_s:9.0f}"
                f"{aim:>6}{apart:10.0e}",
                flush=True,
            )


def scene(key):
    """Return five targets that stay in the field, and what a radar sees of them."""
    places, speeds, noise, seen = jax.random.split(key, 4)
    at = jax.random.uniform(places, (TARGETS, 2), minval=0.25 * FIELD_M, maxval=0.75 * FIELD_M)
    velocity = jax.random.uniform(speeds, (TARGETS, 2), minval=-SPEED_M_S, maxval=SPEED_M_S)
    time_s = jnp.arange(SCANS, dtype=at.dtype)
    truth = move(noise, jnp.concatenate([at, velocity], axis=1), time_s, SIGMA_A)
    return truth, observe(seen, truth, RADAR, detections=PLACES)


def score(tracks, truth):
    curve = ospa_over_time(tracks, truth, cutoff_m=CUTOFF_M, cutoff_m_s=CUTOFF_M, order=1.0)
    return curve.position.distance.mean()


def our_run(name, key, _):
    """Return mean OSPA of the confirmed tracks of one run, and whether the table was ever full."""
    truth, scans = scene(key)
    density = CLUTTER / FIELD_M**2
    params = KalmanTrackerParams(SIGMA, SIGMA_A, P_DETECT, density, BIRTH_M_S, gate=GATE)
    tracker = kalman_tracker(params, max_tracks=SLOTS, associator=name)
    _, info = jax.lax.scan(tracker.step, tracker.init(key), scans)
    sure = info.tracks.mask & (info.tracks.stage >= Stage.CONFIRMED)
    return score(info.tracks._replace(mask=sure), truth), info.full.any().astype(jnp.float64)


def stone_soup_run(name, scans):
    """Return the tracks after each look: those that three detections confirmed."""
    setup = stone_soup.Setup(name, clutter=CLUTTER / FIELD_M**2, **SETTINGS)
    looks = [
        (stone_soup.instant(t), setup.detections(places[mask], t))
        for t, places, mask in zip(scans.time_s, scans.position_m, scans.mask, strict=True)
    ]
    prior = GaussianState(
        np.zeros((4, 1)),
        np.diag([SIGMA**2] * 2 + [BIRTH_M_S**2] * 2),
        stone_soup.EPOCH - datetime.timedelta(seconds=1),
    )
    initiator = MultiMeasurementInitiator(
        prior, UpdateTimeStepsDeleter(2), setup.associator, setup.updater, min_points=3
    )
    tracker = MultiTargetTracker(
        initiator, UpdateTimeStepsDeleter(5), looks, setup.associator, setup.updater
    )

    def run():
        return [
            [np.ravel(track.state.state_vector).astype(float) for track in tracks]
            for _, tracks in tracker
        ]

    return pinned(run)


def table(history):
    """Return Stone Soup's tracks as ours, for the score."""
    mean, mask = np.zeros((SCANS, SLOTS, 4)), np.zeros((SCANS, SLOTS), bool)
    for k, states in enumerate(history):
        mask[k, : len(states)] = True
        mean[k, : len(states)] = np.reshape(states, (-1, 4))
    zero, none = np.zeros((SCANS, SLOTS)), np.zeros((SCANS, SLOTS), np.int32)
    wide = np.zeros((SCANS, SLOTS, 4, 4))
    return Tracks(np.arange(float(SCANS)), mean, wide, mask, none, none, zero, zero)


def run():
    few = 8
    print(
        f"\nMonte Carlo of {RUNS} runs: {TARGETS} targets, {CLUTTER:.0f} clutter a scan, {SCANS} "
        f"scans; Stone Soup timed on the first {few} and scaled\nours simulates and scores in that "
        f"time, Stone Soup only tracks; OSPA with c = {CUTOFF_M:.0f} m, p = 1\n"
        f"{'ours':10}{'compile s':>11}{'s':>8}{'OSPA m':>8}{'full':>6}  {'Stone Soup':11}{'s':>8}"
        f"{'ratio':>8}{'aim':>5}   OSPA m of the same {few}: ours, Stone Soup"
    )
    keys = [jax.random.fold_in(jax.random.key(SEED), n) for n in range(few)]
    drawn = [jax.tree.map(np.asarray, jax.jit(scene)(key)) for key in keys]
    judge = jax.jit(score)
    for ours, theirs in (("greedy", "nn"), ("optimal", "gnn")):
        trial = functools.partial(our_run, ours)
        call = lambda trial=trial: monte_carlo(
            trial, jax.random.key(SEED), RUNS, micro_batch=TOGETHER
        )
        compile_s, run_s = seconds(call, repeats=3)
        mine, full = call().values
        times, scores = [], []
        for truth, scans in drawn:
            elapsed, history = stone_soup_run(theirs, scans)
            times.append(elapsed)
            scores.append(float(judge(table(history), Truth(*truth))))
        their_s = RUNS * float(np.mean(times))
        print(
            f"{ours:10}{compile_s:11.1f}{run_s:8.2f}{mine.mean():8.3f}{full.mean():6.3f}  "
            f"{theirs:11}{their_s:8.0f}{their_s / run_s:8.0f}{500:5d}   "
            f"{mine[:few].mean():.3f}, {np.mean(scores):.3f}",
            flush=True,
        )


def filters():
    """Name → means, covariances or their roots, log-likelihoods from a prior and [K, 2] places."""
    dt, unit = jnp.asarray(1.0), jnp.eye(2)
    f, h = transition_matrix(dt), jnp.eye(2, 4)
    # White-noise acceleration has no root to speak of: a little noise beside it for all three.
    q, r = white_noise_acceleration(dt, SIGMA_A) + 1e-6 * jnp.eye(4), SIGMA**2 * unit
    begin = jnp.zeros(4)

    def ours(wide, places):
        def step(state, z):
            moved = gaussian.predict(*state, f, q)
            after = gaussian.correct(*moved, z - h @ moved.mean, h, r)
            return (after.mean, after.covariance), (*after[:2], after.log_likelihood)

        return jax.lax.scan(step, (begin, wide), places)[1]

    def theirs(wide, places):
        # It updates first and predicts then: its prior is that of the first look.
        params = dynamax.make_lgssm_params(f @ begin, f @ wide @ f.T + q, f, q, h, r)
        found = dynamax.lgssm_filter(params, places)
        return found.filtered_means, found.filtered_covariances, found.marginal_loglik

    def roots(wide, places):
        none, root_q, root_r = jnp.zeros(4), jnp.linalg.cholesky(q), jnp.linalg.cholesky(r)
        engine = square_root.build_filter(
            begin,
            jnp.linalg.cholesky(wide),
            lambda z: (f, none, root_q),
            lambda z: (h, jnp.zeros(2), root_r, z),
        )
        found = cuthbert.filter(engine, places, engine.init_prepare())
        return found.mean[1:], found.chol_cov[1:], found.log_normalizing_constant

    return {"jaxtrack": ours, "dynamax": theirs, "cuthbert": roots}


def filter_():
    looks = 64
    places = jnp.asarray(np.random.default_rng(SEED).normal(size=(BATCH, looks, 2)).cumsum(1))
    # One device: on two at once cuthbert's decompositions were seen to wait for each other forever.
    # Each its own prior: covariances that all share would be computed once for the batch.
    wide = np.random.default_rng(SEED).uniform(5.0, 15.0, (BATCH, 1, 1)) * jnp.eye(4)
    print(
        f"\nKalman predict and update, {looks} looks under a scan, batch {BATCH}, one device\n"
        f"{'':10}{'compile s':>11}{'ns a look':>11}{'ours is':>9}{'differ':>10}"
    )
    mine = None
    for name, one in filters().items():
        batched = functools.partial(jax.jit(jax.vmap(one)), wide, places)
        compile_s, run_s = seconds(batched)
        mean = np.asarray(batched()[0])
        mine = mine or (run_s, mean)
        apart = np.abs(mean - mine[1]).max()
        print(
            f"{name:10}{compile_s:11.1f}{run_s / BATCH / looks * 1e9:11.0f}"
            f"{run_s / mine[0]:8.2f}x{apart:10.0e}",
            flush=True,
        )


PARTS = {"look": look, "run": run, "filter": filter_}


def main(names):
    import stonesoup

    print(
        f"jax {jax.__version__}, Stone Soup {stonesoup.__version__}, {len(jax.devices())} CPU "
        f"devices, Stone Soup pinned to one core, seed {SEED}"
    )
    for name, part in PARTS.items():
        if not names or name in names:
            part()


if __name__ == "__main__":
    main(sys.argv[1:])
