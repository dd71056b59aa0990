"""Jitted gradients of the soft votes against central differences, and on degenerate looks."""

import functools

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from jaxtrack.hough import improved, modified, neutrosophic, standard
from jaxtrack.hough.grid import Grid, Sizes
from jaxtrack.hough.votes import Votes, evaluate, gaussian, scaled_gaussian, soft
from jaxtrack.types import Scan
from tests.hough.cases import ORIGIN, PEAKS, SIZES, SPEED, random_looks
from tests.metrics.differences import assert_gradients_agree

GRID = Grid(ORIGIN, 700.0)
FLOAT = jnp.dtype(np.float64)
# Everything is differentiated in units in which it is of the order of one.
RHO_UNIT, THETA_UNIT = 20.0, 0.1
ONE_MISSING = np.arange(12).reshape(3, 4) != 6


def kernel_loss(make):
    """A loss of votes, tolerances (or scales) and weights, with NaN behind the mask."""
    rng = np.random.default_rng(0)
    mask = np.array([True, True, False, True, True, True])
    hidden = np.where(mask, 0.0, np.nan)
    centre = np.array([3.0, 0.15])
    size = len(mask)
    rho, theta = (centre[:, None] + rng.normal(size=(2, size)) * [[1.0], [0.5]]) % [[99.0], [31.0]]
    factor = rng.normal(size=(size, 2, 2)) * 0.4 + np.eye(2)

    def loss(rho, theta, weight, eps, factor):
        scale = factor @ jnp.swapaxes(factor, 1, 2)
        units = jnp.array([RHO_UNIT**2, RHO_UNIT * THETA_UNIT, THETA_UNIT**2])
        packed = jnp.stack([scale[:, 0, 0], scale[:, 0, 1], scale[:, 1, 1]], -1) * units[None]
        kernel = make(eps[0] * RHO_UNIT, eps[1] * THETA_UNIT, packed + hidden[:, None], mask)
        table = Votes(rho * RHO_UNIT + hidden, theta * THETA_UNIT, weight + hidden, mask)
        at = jnp.array([55.0, 65.0, -70.0]), jnp.array([0.04, 0.12, 3.1])
        return (evaluate(*at, table, kernel) ** 2).sum()

    return loss, (rho, theta, rng.uniform(0.3, 1.0, size), np.array([1.2, 0.9]), factor)


KERNELS = {
    "soft": lambda eps_rho, eps_theta, scale, mask: soft(GRID, SIZES, eps_rho, eps_theta, FLOAT),
    "gaussian": lambda eps_rho, eps_theta, scale, mask: gaussian(eps_rho, eps_theta),
    "scaled gaussian": lambda eps_rho, eps_theta, scale, mask: scaled_gaussian(scale, mask),
}


@pytest.mark.parametrize("name", KERNELS)
def test_gradients_of_kernels_agree_with_central_differences(name):
    loss, arguments = kernel_loss(KERNELS[name])
    assert_gradients_agree(loss, *arguments, atol=1e-8)
    gradient = jax.jit(jax.grad(loss, argnums=(0, 1, 2, 3, 4)))(*arguments)
    used = [np.abs(g).max() > 1e-3 for g in gradient]
    assert used == [True, True, True, name != "scaled gaussian", name == "scaled gaussian"]


@functools.cache
def scan_loss(name):
    """A loss of lines' votes and places: of positions, weights, delays and two tolerances."""
    origin = random_looks(np.random.default_rng(4), 3, 4)

    def value(scan, eps):
        eps_rho, eps_theta = eps[0] * RHO_UNIT, eps[1] * THETA_UNIT
        if name == "standard":
            at = jnp.array([-30.0, 10.0, 100.0, 250.0]), jnp.array([0.3, 0.9, 1.7, 3.0])
            return standard.soft_votes(*at, scan, GRID, eps_rho, eps_theta, sizes=SIZES)
        if name == "modified":
            params = modified.ModifiedParams(GRID, PEAKS)
            got, _ = modified.soft_estimate(scan, params, eps_rho, eps_theta, sizes=SIZES)
        elif name == "improved":
            params = improved.ImprovedParams(GRID, PEAKS, SPEED)
            got, _ = improved.soft_estimate(scan, params, eps_rho, eps_theta, sizes=SIZES)
        else:
            landing, scale = name
            params = neutrosophic.NeutrosophicParams(
                GRID, PEAKS, SPEED, eps_rho_m=eps_rho, eps_theta_rad=eps_theta
            )
            rules = neutrosophic.Rules(landing, scale)
            got, _ = neutrosophic.soft_estimate(scan, params, 0.3, sizes=SIZES, rules=rules)
        return jnp.concatenate([got.votes, got.rho_m / 100.0, got.theta_rad])

    def loss(position, weight, delay, eps, mask):
        hidden = jnp.where(mask, 0.0, jnp.nan)
        scan = Scan(
            jnp.asarray(origin.time_s),
            jnp.asarray(origin.valid),
            position * RHO_UNIT + hidden[..., None],
            jnp.asarray(mask),
            weight=weight + hidden,
            delay_s=delay + hidden,
        )
        return jnp.sin(value(scan, eps)).sum()

    start = (origin.position_m / RHO_UNIT, origin.weight, origin.delay_s, np.array([1.1, 1.3]))
    return loss, start


METHODS = [
    "standard",
    "modified",
    "improved",
    pytest.param(("own_and_kernel_cell", "tolerance"), marks=pytest.mark.slow),
    ("spread", "tolerance"),
    pytest.param(("spread", "covariance"), marks=pytest.mark.slow),
]


@functools.cache
def value_and_gradient(name):
    """One compiled program for every test of a method."""
    return jax.jit(jax.value_and_grad(scan_loss(name)[0], argnums=(0, 1, 2, 3)))


@pytest.mark.parametrize("name", METHODS, ids=str)
def test_gradients_of_methods_agree_with_central_differences(name):
    start = scan_loss(name)[1]
    _, gradient = value_and_gradient(name)(*start, ONE_MISSING)
    for place, got in enumerate(gradient):
        expected = np.zeros(got.shape)
        for index in np.ndindex(got.shape):
            ends = []
            for step in (1e-5, -1e-5):
                moved = [x.copy() for x in start]
                moved[place][index] += step
                ends.append(float(value_and_gradient(name)(*moved, ONE_MISSING)[0]))
            expected[index] = (ends[0] - ends[1]) / 2e-5
        np.testing.assert_allclose(got, expected, rtol=1e-6, atol=1e-7)
    by_position, by_weight, _, by_eps = gradient
    assert np.abs(by_position).max() > 1e-3
    assert np.abs(by_weight).max() > 1e-3
    assert np.abs(by_eps).max() > 1e-3 or name == ("spread", "covariance")


@pytest.mark.parametrize("name", METHODS, ids=str)
def test_gradients_are_finite_on_degenerate_looks(name):
    position, weight, delay, eps = scan_loss(name)[1]
    cases = {
        "coincident": (np.full_like(position, 3.0), weight, 0.0 * delay, eps, ONE_MISSING),
        "on one line": (position * [1.0, 0.0], weight, delay, eps, ONE_MISSING),
        "weightless": (position, 0.0 * weight, delay, eps, ONE_MISSING),
        "far away": (position + 1e6, weight, delay, eps, ONE_MISSING),
        "still": (np.tile(position[:1], (3, 1, 1)), weight, delay, eps, ONE_MISSING),
        "nothing": (position, weight, delay, eps, np.zeros_like(ONE_MISSING)),
    }
    for case, arguments in cases.items():
        value, gradient = value_and_gradient(name)(*arguments)
        assert np.isfinite(value), case
        assert all(np.isfinite(g).all() for g in gradient), case
    assert all((g == 0.0).all() for g in gradient)


@pytest.mark.slow  # compiles for long where nothing is cached
def test_tolerances_of_zero_act_as_hard_votes_and_give_no_nan():
    """Traced, a tolerance cannot be refused: it must not poison a sweep or a step of tuning."""
    scans = Scan(
        jnp.arange(3.0),
        jnp.ones(3, bool),
        jnp.array([[[0.0, 8.0]], [[200.0, 8.0]], [[450.0, 8.0]]]),
        jnp.ones((3, 1), bool),
    )
    sizes = Sizes(lines=1, pairs=4)

    def strongest(eps_rho, eps_theta):
        params = improved.ImprovedParams()
        return improved.soft_estimate(scans, params, eps_rho, eps_theta, sizes=sizes)[0].votes[0]

    def neutral(eps_rho, temperature):
        params = neutrosophic.NeutrosophicParams(eps_rho_m=eps_rho)
        return neutrosophic.soft_estimate(scans, params, temperature, sizes=sizes)[0].votes[0]

    for vote in (strongest, neutral):
        for at in ((0.0, 0.0), (0.0, 0.05), (-20.0, 0.05)):
            value, slopes = jax.jit(jax.value_and_grad(vote, (0, 1)))(*at)
            assert np.isfinite(value)
            assert np.isfinite(slopes).all()
    with pytest.raises(ValueError, match=r"eps_rho_m: got 0\.0, want a positive"):
        strongest(0.0, 0.01)
    with pytest.raises(ValueError, match=r"temperature: got -1\.0, want a positive"):
        neutral(20.0, -1.0)
