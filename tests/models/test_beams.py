"""The likelihood of a multi-beam sonar's looks: against the loop, at the edges, and its slopes."""

import math

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from jaxtrack.models import BEAMS, BeamSensor, BeamSonar
from jaxtrack.models.beam_place import angle
from jaxtrack.models.beams import beam_positions
from jaxtrack.types import BeamScan, Pose
from tests.metrics.differences import assert_gradients_agree
from tests.oracles import beam_joint as oracle

pytestmark = pytest.mark.slow  # compiles for minutes where nothing is cached

LOOKS, COUNT = 5, 9
OTHER = 0.03  # another target answers
score = jax.jit(BEAMS.scores)
ratio = jax.jit(BEAMS.log_likelihood_ratio)
claims = jax.jit(BEAMS.responsibility)


def sonar(p_miss=0.3, p_false=0.3, clutter=0.3):
    return BeamSonar(p_miss, p_false, 5.0, 150.0, 1.5, (1.0, 0.5), clutter)


def random_looks(seed, *, detected=0.5, valid=0.8):
    """Return looks of a wide-beamed sonar; NaN wherever nothing counts."""
    rng = np.random.default_rng(seed)
    there = rng.random(LOOKS) < valid
    mask = rng.random((LOOKS, COUNT)) < detected
    counts = mask & there[:, None]
    return BeamScan(
        time_s=np.where(there, 0.5 * np.arange(LOOKS), np.nan),
        valid=there,
        range_m=np.where(counts, rng.uniform(0.0, 150.0, mask.shape), np.nan),
        mask=mask,
        pose=Pose(
            np.where(there[:, None], rng.normal(size=(LOOKS, 2)), np.nan),
            np.where(there, rng.uniform(-3.0, 3.0, LOOKS), np.nan),
        ),
        weight=np.where(counts, rng.random(mask.shape), np.nan),
    )  # pyright: ignore[reportArgumentType]


def random_states(seed, states=7):
    return np.random.default_rng(seed).normal(size=(states, 4)) * [60.0, 60.0, 3.0, 3.0]


def at_look(scans, k):
    return jax.tree.map(lambda x: x[k], scans)


@pytest.mark.parametrize("detected", [0.0, 0.5, 1.0])
@pytest.mark.parametrize("spread", [0.1, 0.5])
def test_scores_ratios_and_claims_equal_the_loop(detected, spread):
    for seed in range(6):
        scans, states = random_looks(seed, detected=detected), random_states(seed)
        sensor = BeamSensor(sonar(), spread, OTHER)
        some = np.flatnonzero(scans.valid)
        end = float(scans.time_s[some[-1]]) if some.size else 0.0
        expected = [oracle.score(x, end, scans, sensor.sonar, spread, OTHER) for x in states]
        np.testing.assert_allclose(score(states, scans, sensor), expected, rtol=1e-7, atol=1e-6)
        for k in range(LOOKS):
            one = at_look(scans, k)
            arguments = states[0], scans, k, sensor.sonar, spread, OTHER
            want = oracle.log_likelihood_ratio(*arguments)
            np.testing.assert_allclose(ratio(states[0], one, sensor), want, rtol=1e-7, atol=1e-6)
            want = oracle.responsibility(*arguments[:-1])
            np.testing.assert_allclose(claims(states[0], one, sensor), want, rtol=1e-6, atol=1e-9)


def test_what_cannot_be_seen_says_nothing():
    scans = random_looks(1, valid=1.0)._replace(pose=Pose(np.zeros((LOOKS, 2)), np.zeros(LOOKS)))
    beyond = np.array([[400.0, 0.0, 0.0, 0.0], [-50.0, 0.0, 0.0, 0.0], [0.0, 80.0, 0.0, 0.0]])
    np.testing.assert_allclose(score(beyond, scans, BeamSensor(sonar())), 0.0, atol=1e-4)
    lost = scans._replace(valid=np.zeros(LOOKS, bool))
    np.testing.assert_array_equal(score(random_states(0), lost, BeamSensor(sonar())), 0.0)


def test_a_detection_of_weight_zero_says_nothing_for_whoever_is_in_its_beam():
    pose = Pose(np.zeros(2), np.zeros(()))
    look = BeamScan(np.zeros(()), np.bool_(True), np.full(COUNT, 60.0), np.arange(COUNT) == 4, pose)
    angle = (4.5 - COUNT / 2) * float(sonar().sector_rad) / COUNT
    state = np.array([60.0 * np.cos(angle), 60.0 * np.sin(angle), 0.0, 0.0])
    heard, silent = look, look._replace(mask=np.zeros(COUNT, bool))
    ignored = look._replace(weight=np.zeros(COUNT))
    sensor = BeamSensor(sonar(), 0.1, OTHER)
    assert ratio(state, heard, sensor) > 1.0
    assert ratio(state, silent, sensor) < -0.1
    np.testing.assert_allclose(ratio(state, ignored, sensor), 0.0, atol=1e-3)


@pytest.mark.parametrize("p_false", [0.0, 0.7, 1.0])
@pytest.mark.parametrize(("p_miss", "clutter"), [(0.1, 0.0), (0.1, 1.0), (0.7, 0.0), (0.7, 1.0)])
def test_everything_is_finite(p_miss, clutter, p_false):
    sensor = BeamSensor(sonar(p_miss, p_false, clutter))
    for detected in (0.0, 1.0):
        scans = jax.tree.map(jnp.asarray, random_looks(3, detected=detected))
        for state in (np.zeros(4), np.array([1.0, 0.5, 0.0, 0.0]), random_states(3)[0]):
            total = lambda x, s, scans=scans: BEAMS.scores(x[None], scans, s)[0]
            values, slopes = jax.jit(jax.value_and_grad(total, argnums=(0, 1)))(state, sensor)
            refined = jax.jit(BEAMS.refine)(state, scans, sensor)
            for leaf in jax.tree.leaves((values, slopes, refined)):
                assert np.isfinite(leaf).all()


def test_slopes_are_those_of_differences():
    scans = random_looks(4)
    hidden = np.where(scans.mask & scans.valid[:, None], 0.0, np.nan)

    def loss(state, range_m, weight, numbers):
        seen = jax.tree.map(jnp.asarray, scans)._replace(
            range_m=100.0 * range_m + hidden, weight=weight + hidden
        )
        p_miss, p_false, sigma, scope, sector, clutter, spread = numbers
        own = BeamSonar(p_miss, p_false, 5 * sigma, 150 * scope, sector, (1.0, 0.5), clutter)
        return BEAMS.scores(10.0 * state[None], seen, BeamSensor(own, spread))[0]

    numbers = np.array([0.3, 0.3, 1.0, 1.0, 1.5, 0.3, 0.3])
    finite = lambda x: np.where(np.isnan(hidden), 0.0, x)
    for seed in (5, 6):
        state = random_states(seed)[0] / 10.0
        arguments = state, finite(scans.range_m) / 100.0, finite(scans.weight), numbers
        assert_gradients_agree(loss, *arguments, rtol=1e-6, atol=1e-7)


def test_a_batch_equals_the_loop_and_float32_follows():
    scans, states = jax.tree.map(jnp.asarray, random_looks(7)), random_states(7)
    sensor = BeamSensor(sonar(), 0.3)
    each = [float(score(x[None], scans, sensor)[0]) for x in states]
    batch = jax.jit(jax.vmap(lambda x: BEAMS.scores(x[None], scans, sensor)[0]))(states)
    np.testing.assert_allclose(batch, each, rtol=1e-12, atol=1e-12)
    short = lambda x: np.asarray(x, np.float32) if x.dtype == np.float64 else x
    low = score(short(states), jax.tree.map(short, scans), sensor)
    assert low.dtype == jnp.float32
    np.testing.assert_allclose(low, each, rtol=1e-3, atol=1e-2)


def test_refinement_finds_a_clean_target():
    truth = np.array([60.0, 10.0, 1.0, -2.0])
    own = BeamSonar(0.01, 1e-6, 0.5)
    pose = Pose(np.zeros((8, 2)), np.zeros(8))
    dt = 0.5 * np.arange(-7.0, 1.0)
    place = truth[:2] + dt[:, None] * truth[2:]
    beam = np.floor(np.arctan2(place[:, 1], place[:, 0]) / (math.pi / 180) + 45).astype(int)
    mask = np.arange(90) == beam[:, None]
    range_m = np.where(mask, np.hypot(*place.T)[:, None], np.nan)
    scans = BeamScan(dt, np.ones(8, bool), range_m, mask, pose)  # pyright: ignore[reportArgumentType]
    state = truth + np.array([1.0, -0.5, 0.2, 0.2])
    sensor = BeamSensor(own, 0.3)
    for _ in range(6):
        state = jax.jit(BEAMS.refine)(state, scans, sensor)
    np.testing.assert_allclose(state, truth, atol=0.6)
    information = jax.jit(BEAMS.information)(state, scans, sensor)
    assert (np.linalg.eigvalsh(information) > 0).all()
    back = beam_positions(scans, sensor)
    np.testing.assert_allclose(back.position_m[mask], place, atol=1.1 * math.pi / 360 * 65)


def test_angle_is_the_arctangent():
    turn = np.linspace(-math.pi, math.pi, 1001)
    got = jax.jit(angle)(3.0 * np.sin(turn), 3.0 * np.cos(turn))
    np.testing.assert_allclose(got, np.arctan2(np.sin(turn), np.cos(turn)), atol=1e-8)
    assert np.isfinite(jax.grad(lambda y: angle(y, jnp.zeros(())))(jnp.zeros(())))
