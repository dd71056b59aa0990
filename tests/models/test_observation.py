"""What one look says about a state, against loops over its detections."""

import math

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from jaxtrack.models.observation import (
    POSITION,
    PositionSensor,
    position_log_likelihood_ratio,
    position_refine,
    position_responsibility,
    position_scores,
)
from jaxtrack.types import Scan
from tests.metrics.differences import assert_gradients_agree
from tests.oracles import joint

few = settings(max_examples=25, deadline=None, derandomize=True, database=None)
SIZE = 5
LOOKS = 3
SENSOR = PositionSensor(p_detect=0.85, clutter_per_m2=2e-5, sigma_m=12.0)
ratio, responsibility = jax.jit(position_log_likelihood_ratio), jax.jit(position_responsibility)


def random_look(seed, *, covariance):
    """Return a state and one look of detections around it."""
    rng = np.random.default_rng(seed)
    state = np.concatenate([rng.normal(scale=500.0, size=2), rng.normal(scale=150.0, size=2)])
    delay = rng.uniform(-0.3, 0.3, SIZE)
    factor = rng.normal(scale=12.0, size=(SIZE, 2, 2)) + 8.0 * np.eye(2)
    position = state[:2] + delay[:, None] * state[2:] + rng.normal(scale=20.0, size=(SIZE, 2))
    return state, Scan(
        time_s=np.float64(rng.uniform(0.0, 9.0)),
        valid=np.bool_(True),
        position_m=position,
        mask=np.ones(SIZE, bool),
        covariance_m2=factor @ factor.transpose(0, 2, 1) if covariance else None,
        weight=rng.uniform(0.0, 1.0, SIZE),
        delay_s=delay,
    )  # pyright: ignore[reportArgumentType]


@st.composite
def cases(draw):
    state, look = random_look(draw(st.integers(0, 2**32 - 1)), covariance=draw(st.booleans()))
    mask = np.array(draw(st.lists(st.booleans(), min_size=SIZE, max_size=SIZE)))
    hide = lambda x: np.where(mask.reshape((SIZE,) + (1,) * (x.ndim - 1)), x, np.nan)
    return state, look._replace(
        valid=np.bool_(draw(st.sampled_from((True, True, True, False)))),
        mask=mask,
        position_m=hide(look.position_m),
        weight=hide(look.weight),
        delay_s=hide(look.delay_s),
        covariance_m2=None if look.covariance_m2 is None else hide(look.covariance_m2),
    )


def oracle(state, look, sensor=SENSOR):
    window = jax.tree.map(lambda x: np.asarray(x)[None], look)
    return joint.log_likelihood_ratio(
        state, window, 0, sensor.p_detect, sensor.clutter_per_m2, sensor.sigma_m
    )


@few
@given(cases())
def test_ratio_equals_the_oracle(case):
    state, look = case
    got = ratio(state, look, SENSOR)
    np.testing.assert_allclose(got, oracle(state, look), rtol=1e-10, atol=1e-12)


@few
@given(cases())
def test_responsibility_is_what_a_detection_adds(case):
    state, look = case
    look = look._replace(valid=np.bool_(True))
    got = responsibility(state, look, SENSOR)
    whole = math.exp(oracle(state, look))
    for n in range(SIZE):
        without = look.mask & (np.arange(SIZE) != n)
        share = 1.0 - math.exp(oracle(state, look._replace(mask=without))) / whole
        np.testing.assert_allclose(got[n], share, rtol=1e-9, atol=1e-12)


def random_window(seed, *, covariance):
    """Return states at the last look, and looks at the first of them."""
    rng = np.random.default_rng(seed)
    state, _ = random_look(seed, covariance=False)
    window = [random_look(s, covariance=covariance) for s in rng.integers(0, 2**32, LOOKS)]
    looks = []
    for k, (centre, look) in enumerate(window):
        there = joint.moved(state, 2.0 * (k - LOOKS + 1))[:2]
        position = look.position_m - centre[:2] + there
        looks.append(look._replace(time_s=np.float64(2.0 * k), position_m=position))
    scans = jax.tree.map(lambda *x: np.stack(x), *looks)
    scans.mask[rng.random(scans.mask.shape) < 0.3] = False
    scans.position_m[~scans.mask] = np.nan
    scans.weight[~scans.mask] = np.nan
    scans.valid[0] = rng.random() < 0.5
    return state + rng.normal(scale=[20.0, 20.0, 5.0, 5.0], size=(4, 4)), scans


@pytest.mark.parametrize("covariance", [False, True])
def test_scores_equal_the_oracle(covariance):
    scores = jax.jit(position_scores)
    for seed in range(8):
        states, scans = random_window(seed, covariance=covariance)
        end = float(scans.time_s[-1])
        expected = [joint.score(state, end, scans, *SENSOR[:3]) for state in states]
        np.testing.assert_allclose(scores(states, scans, SENSOR), expected, rtol=1e-10)


def test_refinement_never_lowers_the_score():
    step, scores = jax.jit(jax.vmap(position_refine, (0, None, None))), jax.jit(position_scores)
    gained = 0
    for seed in range(20):
        states, scans = random_window(seed, covariance=False)
        before = scores(states, scans, SENSOR)
        after = scores(step(states, scans, SENSOR), scans, SENSOR)
        assert (after >= before - 1e-9).all()
        gained += int((after > before + 0.01).sum())
    assert gained > 20


def test_fields_left_out_are_ones_zeros_and_the_sensors_own_noise():
    state, look = random_look(1, covariance=False)
    bare = look._replace(weight=None, delay_s=None)
    same = np.tile(SENSOR.sigma_m**2 * np.eye(2), (SIZE, 1, 1))
    full = look._replace(weight=np.ones(SIZE), delay_s=np.zeros(SIZE), covariance_m2=same)
    expected = ratio(state, bare, SENSOR)
    np.testing.assert_allclose(expected, oracle(state, bare), rtol=1e-10)
    np.testing.assert_allclose(ratio(state, full, SENSOR), expected, rtol=1e-12)


def test_no_look_says_nothing_and_an_empty_one_speaks_against():
    state, look = random_look(2, covariance=True)
    empty = look._replace(mask=np.zeros(SIZE, bool))
    assert ratio(state, look._replace(valid=np.bool_(False)), SENSOR) == 0.0
    assert float(ratio(state, empty, SENSOR)) == pytest.approx(math.log(0.15))


@pytest.mark.parametrize("covariance", [False, True])
def test_gradients_agree_with_central_differences(covariance):
    state, look = random_look(3, covariance=covariance)
    mask = np.array([True, False, True, True, False])
    hidden = jnp.where(mask, 0.0, jnp.nan)
    scale = np.array([1.0, 1.0, 1.0, 1.0]) * 10.0

    def loss(state, position, weight, delay, shape, sensor):
        r = None
        if covariance:
            r = (shape @ jnp.swapaxes(shape, 1, 2)) * 100.0 + hidden[:, None, None]
        scan = look._replace(
            mask=mask,
            position_m=position * 10.0 + hidden[:, None],
            weight=weight + hidden,
            delay_s=delay + hidden,
            covariance_m2=r,
        )
        sensor = PositionSensor(sensor[0], sensor[1] * 1e-5, sensor[2] * 10.0)
        return position_log_likelihood_ratio(state * scale, scan, sensor)

    shape = np.random.default_rng(4).normal(size=(SIZE, 2, 2)) + 2.0 * np.eye(2)
    arguments = (state / scale, look.position_m / 10.0, look.weight, look.delay_s, shape)
    assert_gradients_agree(loss, *arguments, np.array([0.8, 2.0, 1.3]), atol=1e-8)
    gradient = jax.jit(jax.grad(loss, argnums=(0, 1, 2, 3)))(*arguments, np.array([0.8, 2.0, 1.3]))
    assert all(np.abs(g).max() > 1e-3 for g in gradient)


@pytest.mark.parametrize("case", ["all masked", "no look", "coincident"])
def test_gradients_are_finite_on_degenerate_looks(case):
    state, look = random_look(5, covariance=True)
    look = {
        "all masked": look._replace(
            mask=np.zeros(SIZE, bool), covariance_m2=np.full((SIZE, 2, 2), np.nan)
        ),
        "no look": look._replace(valid=np.bool_(False), position_m=np.full((SIZE, 2), np.nan)),
        "coincident": look._replace(position_m=np.tile(state[:2], (SIZE, 1))),
    }[case]
    gradient = jax.jit(jax.grad(position_log_likelihood_ratio, allow_int=True, argnums=(0, 2)))(
        state, look, SENSOR
    )
    assert all(np.isfinite(g).all() for g in jax.tree.leaves(gradient))


def test_blur_widens_own_covariances_too():
    scan = Scan(
        jnp.array(0.0),
        jnp.array(True),
        jnp.array([[3.0, -4.0]]),
        jnp.array([True]),
        covariance_m2=jnp.array([[[30.0, 5.0], [5.0, 20.0]]]),
    )
    assert scan.covariance_m2 is not None
    wide = scan._replace(covariance_m2=4.0 * scan.covariance_m2)
    state = jnp.array([1.0, 2.0, 0.0, 0.0])
    got = position_log_likelihood_ratio(state, scan, POSITION.blur(SENSOR, 2.0))
    np.testing.assert_allclose(got, position_log_likelihood_ratio(state, wide, SENSOR), rtol=1e-14)
