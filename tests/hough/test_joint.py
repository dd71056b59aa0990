"""The joint space–time vote: its search, its maximum, its covariance and its gradients."""

import functools
import math

import chex
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import given

from jaxtrack.hough import gate_for_false_rate
from jaxtrack.hough.joint import JointParams, JointSizes, estimate, lines_of
from jaxtrack.hough.pairs import SpeedGate, distant_pairs
from jaxtrack.models.observation import PositionSensor
from jaxtrack.montecarlo import interval_of_mean, mean_and_error, monte_carlo
from jaxtrack.sensors import crossing_targets, observe
from jaxtrack.types import Scan, Stage, Tracks
from tests.hough.cases import few, looks, with_nan_behind_masks
from tests.metrics.differences import assert_gradients_agree
from tests.oracles import joint as oracle
from tests.oracles import lines
from tests.oracles.pairs import detections

LOOKS, SIZE = 5, 4
FIELD = (2000.0, 1200.0)
CLUTTER = SIZE / (FIELD[0] * FIELD[1])
SPEED = SpeedGate(80.0, 400.0)
GAP = 2
SIZES = JointSizes(tracks=3, hypotheses=128, candidates=64, starts=16, gap=GAP)
track = jax.jit(functools.partial(estimate, sizes=SIZES))


def joint_params(gate=12.0, sigma_m=10.0, p_detect=0.9, clutter_per_m2=CLUTTER):
    return JointParams(PositionSensor(p_detect, clutter_per_m2, sigma_m), SPEED, gate)


def random_scene(seed, *, targets=1, covariance=False):
    """Return looks 2 s apart at straight targets in clutter: detection i < targets is target i's.

    The targets cross in the middle of the window, give or take.
    """
    rng = np.random.default_rng(seed)
    time_s = 2.0 * np.arange(LOOKS)
    delay_s = rng.uniform(-0.2, 0.2, (LOOKS, SIZE))
    position = rng.uniform((0.0, 0.0), FIELD, (LOOKS, SIZE, 2))
    factor = rng.normal(scale=3.0, size=(LOOKS, SIZE, 2, 2)) + 10.0 * np.eye(2)
    heading = rng.uniform(0.0, 2 * math.pi)
    for target in range(targets):
        along = np.array([math.cos(heading + target), math.sin(heading + target)])
        elapsed = time_s + delay_s[:, target] - 4.0
        position[:, target] = rng.normal((1000.0, 600.0), 60.0)
        position[:, target] += elapsed[:, None] * rng.uniform(150.0, 250.0) * along
        position[:, target] += 10.0 * rng.normal(size=(LOOKS, 2))
    return Scan(
        time_s=time_s,
        valid=np.ones(LOOKS, bool),
        position_m=position,
        mask=np.ones((LOOKS, SIZE), bool),
        covariance_m2=factor @ np.swapaxes(factor, 2, 3) if covariance else None,
        weight=rng.uniform(0.5, 1.0, (LOOKS, SIZE)),
        delay_s=delay_s,
    )  # pyright: ignore[reportArgumentType]


def with_holes(scan, seed, *, lost=True):
    """Return the scene with detections missing, and one look lost; NaN wherever nothing counts."""
    rng = np.random.default_rng(seed)
    scan.mask[rng.random(scan.mask.shape) < 0.15] = False
    scan = with_nan_behind_masks(scan)
    if lost:
        gone = rng.integers(LOOKS - 1)  # the last look's time is that of the tracks
        scan.valid[gone] = False
        scan = with_nan_behind_masks(scan)
        scan.time_s[gone] = np.nan
    return scan


def oracle_score(state, scan, params):
    return oracle.score(np.asarray(state), float(scan.time_s[-1]), scan, *params.sensor[:3])


def regression(scan, target=0):
    """Return position and velocity at the last look of a target's detections, and (AᵀA)⁻¹."""
    t = scan.time_s + scan.delay_s[:, target] - scan.time_s[-1]
    design = np.stack([np.ones(LOOKS), t], axis=-1)
    inverse = np.linalg.inv(design.T @ design)
    return (inverse @ design.T @ scan.position_m[:, target]).ravel(), inverse


def assert_same_tracks(got, expected, rtol=1e-9):
    chex.assert_trees_all_close(got, expected, rtol=rtol, atol=1e-8)


# --- the search -----------------------------------------------------------------------------------


through_pairs = jax.jit(functools.partial(distant_pairs, gap=GAP, hypotheses=300))


@few
@given(looks())
def test_distant_pairs_equal_the_loop(scan):
    states, mask, overflow = through_pairs(scan, SPEED)
    expected = []
    end = float(scan.time_s[-1])
    counted = [[d for d in detections(scan, k) if d.weight > 0] for k in range(len(scan.time_s))]
    for gap in range(GAP, len(counted)):
        for k in range(len(counted) - gap):
            for b in counted[k + gap]:
                for a in counted[k]:
                    elapsed = b.time - a.time
                    speed = math.dist(a.position, b.position) / elapsed
                    if SPEED.v_min_m_s <= speed <= SPEED.v_max_m_s:
                        velocity = (b.position - a.position) / elapsed
                        expected.append([*(b.position + velocity * (end - b.time)), *velocity])
    assert not overflow
    np.testing.assert_array_equal(mask, np.arange(300) < len(expected))
    np.testing.assert_allclose(
        states[: len(expected)], np.reshape(expected, (-1, 4)), rtol=1e-10, atol=1e-8
    )
    np.testing.assert_array_equal(states[len(expected) :], 0.0)


@pytest.mark.slow  # tables of other sizes compile anew
def test_a_table_too_small_says_so():
    scan = random_scene(0)
    states, mask, _ = distant_pairs(scan, SPEED, gap=GAP, hypotheses=128)
    fitting = int(mask.sum())
    for size, overflows in ((fitting, False), (fitting - 1, True)):
        cut, mask, overflow = distant_pairs(scan, SPEED, gap=GAP, hypotheses=size)
        assert bool(overflow) == overflows
        assert mask.all()
        np.testing.assert_array_equal(cut, states[:size])
    small = jax.jit(functools.partial(estimate, sizes=SIZES._replace(hypotheses=fitting - 1)))
    assert small(scan, joint_params())[1].overflow
    assert not track(scan, joint_params())[1].overflow


all_starts = jax.jit(
    functools.partial(
        estimate, sizes=JointSizes(tracks=1, hypotheses=96, candidates=96, starts=96, gap=GAP)
    )
)


@pytest.mark.parametrize("covariance", [False, True])
def test_the_best_track_is_no_worse_than_the_best_of_all_pairs(covariance):
    params = joint_params(gate=0.0)
    for seed in range(12):
        scan = with_holes(random_scene(seed, covariance=covariance), seed, lost=seed % 2 == 0)
        tracks, info = all_starts(scan, params)
        best = oracle.best_pair_hypothesis(
            scan, *params.sensor[:3], SPEED.v_min_m_s, SPEED.v_max_m_s, GAP
        )
        assert not info.overflow
        if best is None or best.score <= 0.0:
            continue
        assert float(tracks.log_score[0]) >= best.score - 1e-9
        score = oracle_score(tracks.mean[0], scan, params)
        np.testing.assert_allclose(tracks.log_score[0], score, rtol=1e-10)


# --- the maximum and its covariance ---------------------------------------------------------------


def test_of_a_single_clean_target_it_is_least_squares():
    # Next to no misses and no clutter: every detection is the target's beyond doubt.
    params = joint_params(p_detect=0.999, clutter_per_m2=1e-12)
    for seed in range(5):
        scan = random_scene(seed)
        scan.mask[:, 1:] = False
        tracks, info = track(with_nan_behind_masks(scan), params)
        expected, inverse = regression(scan)
        np.testing.assert_array_equal(tracks.mask, [True, False, False])
        np.testing.assert_allclose(tracks.mean[0], expected, rtol=0, atol=1e-6)
        covariance = 100.0 * np.kron(inverse, np.eye(2))
        np.testing.assert_allclose(tracks.covariance[0], covariance, rtol=1e-6, atol=1e-8)
        np.testing.assert_allclose(info.responsibility[0, :, 0], 1.0, atol=1e-6)


@pytest.mark.parametrize("covariance", [False, True])
def test_covariance_is_the_inverse_curvature_of_the_score(covariance):
    params = joint_params()
    step = np.array([0.02, 0.02, 0.005, 0.005])
    for seed in range(3):
        scan = with_holes(random_scene(seed, covariance=covariance), seed, lost=False)
        tracks, _ = all_starts(scan, params)  # a single track: nothing is taken from it
        assert tracks.mask[0]
        mean = np.asarray(tracks.mean[0])
        score = lambda *moves, at=mean, seen=scan: oracle_score(
            at + sum(sign * step * np.eye(4)[axis] for axis, sign in moves), seen, params
        )
        hessian = np.zeros((4, 4))
        for a in range(4):
            # At the maximum no direction leads up.
            assert score((a, 1)) < score()
            assert score((a, -1)) < score()
            for b in range(4):
                mixed = [
                    score((a, one), (b, other)) * one * other
                    for one in (1, -1)
                    for other in (1, -1)
                ]
                hessian[a, b] = sum(mixed) / (4 * step[a] * step[b])
        expected = np.linalg.inv(-hessian)
        scale = np.sqrt(np.diag(expected))
        difference = (np.asarray(tracks.covariance[0]) - expected) / np.outer(scale, scale)
        # The curvature is taken where the search ends, the mean is one Newton step on.
        np.testing.assert_allclose(difference, 0.0, atol=1e-3)


def test_both_of_two_crossing_targets_are_found():
    for seed in range(6):
        scan = random_scene(100 + seed, targets=2)
        tracks, info = track(scan, joint_params(gate=15.0))
        assert not tracks.mask[2]
        np.testing.assert_array_equal(tracks.identity, [0, 1, -1])
        for target in range(2):
            expected, inverse = regression(scan, target)
            error = np.abs(np.asarray(tracks.mean[:2]) - expected) / 10.0
            error /= np.sqrt(np.kron(np.diag(inverse), np.ones(2)))
            nearest = int(error.max(axis=1).argmin())
            assert error[nearest].max() < 1.0  # where they meet, each may claim of the other
            assert (info.responsibility[nearest, :, target] > 0.5).sum() >= LOOKS - 1
        assert (info.responsibility.sum(0) < 1.0 + 1e-9).all()


# --- what must not matter -------------------------------------------------------------------------


@pytest.mark.slow
def test_order_padding_and_what_is_behind_masks_change_nothing():
    rng = np.random.default_rng(0)
    for seed in range(4):
        scan = with_holes(random_scene(seed, covariance=True), seed)
        expected, info = track(scan, joint_params(gate=3.0))
        pad = lambda x: np.pad(
            x,
            ((0, 0), (0, 2)) + ((0, 0),) * (x.ndim - 2),
            constant_values=False if x.dtype == bool else np.nan,
        )
        order = np.argsort(rng.random((LOOKS, SIZE + 2)), axis=1)
        shuffle = lambda x, order=order: np.stack([row[o] for row, o in zip(x, order, strict=True)])
        other = scan._replace(
            **{
                name: shuffle(pad(getattr(scan, name)))
                for name in ("position_m", "mask", "covariance_m2", "weight", "delay_s")
            }
        )
        got, other_info = track(other, joint_params(gate=3.0))
        assert expected.mask.any()
        assert_same_tracks(got, expected)
        claims = np.stack([shuffle(pad(np.asarray(r))) for r in info.responsibility])
        np.testing.assert_allclose(
            other_info.responsibility, np.nan_to_num(claims), rtol=1e-8, atol=1e-10
        )


@pytest.mark.slow
def test_detections_of_weight_zero_are_as_if_masked():
    scan = random_scene(3)
    scan.mask[1, 2] = scan.mask[3, 1] = False
    _, there, _ = distant_pairs(scan, SPEED, gap=GAP, hypotheses=128)
    # In a table that the others fill there is no room for them.
    sizes = SIZES._replace(hypotheses=int(there.sum()))
    tight = jax.jit(functools.partial(estimate, sizes=sizes))
    weightless = scan._replace(
        weight=np.where(scan.mask, scan.weight, 0.0), mask=np.ones_like(scan.mask)
    )
    expected, info = tight(scan, joint_params(gate=3.0))
    got, other = tight(weightless, joint_params(gate=3.0))
    assert not info.overflow
    assert not other.overflow
    assert_same_tracks(got, expected)


def test_a_lost_look_says_nothing_and_an_empty_one_speaks_against():
    scan = random_scene(4)
    params = joint_params()
    lost, empty = scan._replace(valid=scan.valid.copy()), scan._replace(mask=scan.mask.copy())
    lost.valid[2] = False
    empty.mask[2] = False
    lost, empty = with_nan_behind_masks(lost), with_nan_behind_masks(empty)
    lost = lost._replace(time_s=np.where(lost.valid, lost.time_s, np.nan))
    (of_lost, _), (of_empty, _) = track(lost, params), track(empty, params)
    np.testing.assert_allclose(of_lost.mean[0], of_empty.mean[0], rtol=1e-9)
    difference = of_lost.log_score[0] - of_empty.log_score[0]
    np.testing.assert_allclose(difference, -math.log(0.1), rtol=1e-9)


def degenerate(name):
    scan = random_scene(5)
    if name == "all masked":
        return with_nan_behind_masks(scan._replace(mask=np.zeros_like(scan.mask)))
    if name == "all looks lost":
        return with_nan_behind_masks(scan._replace(valid=np.zeros_like(scan.valid)))
    if name == "one detection":
        return with_nan_behind_masks(
            scan._replace(mask=np.arange(scan.mask.size).reshape(scan.mask.shape) == 6)
        )
    if name == "all in one place":
        return scan._replace(position_m=np.full_like(scan.position_m, 500.0))
    return scan._replace(position_m=np.repeat(scan.position_m[:, :1], SIZE, axis=1))


DEGENERATE = ("all masked", "all looks lost", "one detection", "all in one place", "coincident")


@pytest.mark.parametrize("name", DEGENERATE)
def test_degenerate_looks_give_no_nan(name):
    tracks, info = track(degenerate(name), joint_params())
    for leaf in jax.tree.leaves((tracks, info.responsibility)):
        assert np.isfinite(leaf).all()
    assert not np.isnan(info.hypothesis).any()
    assert not np.isnan(info.hypothesis_score).any()
    assert bool(tracks.mask.any()) == (name == "coincident")
    for table in (tracks.mean, tracks.covariance, tracks.log_score, tracks.existence):
        np.testing.assert_array_equal(table[~tracks.mask], 0.0)
    np.testing.assert_array_equal(tracks.identity == -1, ~tracks.mask)
    np.testing.assert_array_equal(tracks.stage == Stage.EMPTY, ~tracks.mask)
    # Where no pair could be a target, there is no track however low the gate.
    lowest, info = track(degenerate(name), joint_params(gate=-1e3))
    assert bool(lowest.mask.any()) == bool(np.isfinite(info.hypothesis_score).any())


# --- gradients ------------------------------------------------------------------------------------


def test_gradients_are_those_of_the_maximum():
    units = np.array([100.0, 100.0, 10.0, 10.0])
    time_s = 2.0 * np.arange(LOOKS)
    mask = np.arange(LOOKS * SIZE).reshape(LOOKS, SIZE) != 7
    hidden = np.where(mask, 0.0, np.nan)

    def loss(position, weight, delay, sensor):
        position, weight = 100.0 * position + hidden[..., None], weight + hidden
        scan = Scan(
            time_s, np.ones(LOOKS, bool), position, mask, weight=weight, delay_s=0.1 * delay
        )
        params = joint_params(12.0, 10.0 * sensor[0], 0.9 * sensor[1], 1e-6 * sensor[2])
        tracks, _ = track(scan, params)
        target = tracks.mean[0] / units
        return (target * jnp.array([0.6, -0.7, 0.8, 0.3])).sum() + 0.1 * tracks.log_score[0]

    sensor = np.array([1.0, 1.0, CLUTTER * 1e6])
    for seed in (0, 3):
        scan = random_scene(seed)
        # The search ends after some steps, and one Newton step from there is not yet the maximum:
        # what one sees by moving its inputs is the maximum's slope to seven digits.
        arguments = (scan.position_m / 100.0, scan.weight, scan.delay_s / 0.1, sensor)
        assert_gradients_agree(loss, *arguments, rtol=1e-6, atol=1e-7)
    gradients = jax.jit(jax.grad(loss, argnums=(0, 1, 2, 3)))(*arguments)
    assert all(np.abs(g).max() > 1e-3 for g in gradients)


@jax.jit
@functools.partial(jax.grad, argnums=(0, 1, 2, 3))
def gradient_of_all(position, weight, delay, sensor, scan):
    seen = scan._replace(position_m=position, weight=weight, delay_s=delay)
    tracks, _ = track(seen, JointParams(PositionSensor(*sensor), SPEED, 12.0))
    return tracks.mean.sum() + tracks.log_score.sum() + tracks.covariance.sum()


@pytest.mark.parametrize("name", DEGENERATE)
def test_gradients_are_finite_on_degenerate_looks(name):
    scan = degenerate(name)
    sensor = np.array([0.9, CLUTTER, 10.0])
    gradients = gradient_of_all(scan.position_m, scan.weight, scan.delay_s, sensor, scan)
    assert all(np.isfinite(g).all() for g in gradients)


# --- as a function --------------------------------------------------------------------------------


@pytest.mark.slow
def test_other_values_do_not_compile_anew_and_batches_equal_loops():
    once = jax.jit(
        chex.assert_max_traces(lambda scan, params: estimate(scan, params, sizes=SIZES), n=1)
    )
    scans = [random_scene(seed) for seed in range(3)]
    each = [joint_params(*values) for values in ((12.0, 10.0), (3.0, 8.0, 0.95), (5.0, 12.0, 0.8))]
    alone = [once(scan, params) for scan, params in zip(scans, each, strict=True)]
    batch = lambda trees: jax.tree.map(lambda *x: jnp.stack([jnp.asarray(v) for v in x]), *trees)
    got = jax.jit(jax.vmap(functools.partial(estimate, sizes=SIZES)))(batch(scans), batch(each))
    assert_same_tracks(got[0], batch([tracks for tracks, _ in alone]))
    assert got[0].mask[:, 0].all()


def test_tracks_stand_in_order_of_their_scores_above_the_gate():
    scan = random_scene(101, targets=2)
    everything, _ = track(scan, joint_params(gate=0.5))
    assert (jnp.diff(everything.log_score) <= 0).all()
    assert (everything.existence[everything.mask] >= 0.5).all()
    one, _ = track(scan, joint_params(gate=float(everything.log_score[0]) - 1e-6))
    np.testing.assert_array_equal(one.mask, [True, False, False])
    np.testing.assert_array_equal(one.stage, [Stage.TENTATIVE, Stage.EMPTY, Stage.EMPTY])


def test_lines_are_those_that_tracks_move_on():
    rng = np.random.default_rng(0)
    mean = np.concatenate([rng.normal(scale=900.0, size=(5, 2)), rng.normal(size=(5, 2))], -1)
    mean[2, 2:] = 0.0
    mask = np.array([True, True, True, False, True])
    votes = np.arange(5.0, 0.0, -1.0)
    empty = np.full(5, np.nan)
    tracks = Tracks(np.float64(0.0), mean, empty, mask, empty, empty, empty, votes)  # pyright: ignore
    got = jax.jit(lines_of)(tracks)
    np.testing.assert_array_equal(got.mask, [True, True, False, False, True])
    for n in (0, 1, 4):
        rho, theta = lines.line_through(mean[n, :2], mean[n, :2] + mean[n, 2:], (0.0, 0.0))
        difference = lines.difference(float(got.rho_m[n]), float(got.theta_rad[n]), rho, theta)
        np.testing.assert_allclose(difference, 0.0, atol=1e-9)
        assert got.votes[n] == votes[n]
    for table in got[:3]:
        np.testing.assert_array_equal(table[2:4], 0.0)


@pytest.mark.parametrize(
    ("change", "error", "message"),
    [
        ({"tracks": 0}, ValueError, "sizes.tracks: got 0, want an int ≥ 1"),
        ({"starts": 2.0}, TypeError, "sizes.starts: got float, want a Python int"),
        ({"gap": LOOKS}, ValueError, "number of looks: got 5, want an int ≥ 6"),
    ],
)
def test_wrong_sizes_are_told(change, error, message):
    with pytest.raises(error, match=message):
        estimate(random_scene(0), joint_params(), sizes=SIZES._replace(**change))


# --- false tracks ---------------------------------------------------------------------------------


@pytest.mark.slow
def test_a_gate_from_the_false_track_rate_keeps_it():
    scene = crossing_targets("IV", clutter_per_scan=10.0)
    free = scene.truth._replace(mask=jnp.zeros_like(scene.truth.mask))
    sensor = PositionSensor(0.99, 10.0 / (3500.0 * 1600.0), 10.0)
    sizes = JointSizes(hypotheses=4096)
    rate, scenes = 0.05, 300

    def scores(key, gate):
        scans = observe(key, free, scene.radar, detections=32)
        tracks, info = estimate(scans, JointParams(sensor, SpeedGate(), gate), sizes=sizes)
        return tracks.log_score, tracks.mask, info.overflow

    first = monte_carlo(scores, jax.random.key(20), scenes, 0.0, micro_batch=1).values
    assert not first[2].any()
    gate = gate_for_false_rate(jnp.asarray(first[0]), jnp.asarray(first[1]), rate)
    assert (first[0] >= float(gate)).sum() == round(rate * scenes)
    fresh = monte_carlo(scores, jax.random.key(21), scenes, float(gate), micro_batch=1).values
    mean, error = mean_and_error(fresh[1].sum(axis=1))
    # The gate has an error of its own, as large as that of the fresh mean.
    lower, upper = interval_of_mean(mean, math.sqrt(2.0) * error)
    assert lower <= rate <= upper
