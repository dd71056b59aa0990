"""What every window estimator and every vote kernel promises, whatever it computes.

A new estimator joins by a line in `ESTIMATORS`, a new kernel by one in `KERNELS`. Estimators that
take one look after the other promise the same, but of their tables of tracks: the Kalman tracker is
asked in `tests/tracking/test_kalman_tracker.py`.
"""

import collections
import functools

import chex
import jax
import jax.numpy as jnp
import numpy as np
import pytest

from jaxtrack.hough import improved, modified, neutrosophic, standard
from jaxtrack.hough.neutrosophic import NeutrosophicParams, Rules
from jaxtrack.hough.votes import Votes, evaluate, gaussian, hard, scaled_gaussian, soft
from tests.hough.cases import GRID, PEAKS, SIZES, SPEED, random_looks
from tests.oracles import lines

LOOKS, SIZE = 4, 5
NEUTROSOPHIC = NeutrosophicParams(GRID, PEAKS, SPEED, eps_rho_m=20.0, eps_theta_rad=0.15)
SMOOTH = SIZES._replace(smooth=1)


def soft_pairs(method):
    """Put the tolerances of a soft method among its parameters."""
    return lambda scans, params, sizes: method.soft_estimate(scans, *params, sizes=sizes)


# name: (estimate(scans, params, sizes=…), params, sizes)
ESTIMATORS = {
    "standard": (standard.estimate, standard.StandardParams(GRID, PEAKS), SIZES),
    "modified": (modified.estimate, modified.ModifiedParams(GRID, PEAKS), SIZES),
    "improved, smoothed": (
        improved.estimate,
        improved.ImprovedParams(GRID, PEAKS, SPEED),
        SMOOTH,
    ),
    "improved, soft": (
        soft_pairs(improved),
        (improved.ImprovedParams(GRID, PEAKS, SPEED), 20.0, 0.1),
        SIZES,
    ),
    "neutrosophic, own cell": (
        functools.partial(neutrosophic.estimate, rules=Rules("own_cell", "covariance")),
        NEUTROSOPHIC,
        SMOOTH,
    ),
    "neutrosophic, both cells": (
        functools.partial(neutrosophic.estimate, rules=Rules("own_and_kernel_cell")),
        NEUTROSOPHIC,
        SIZES,
    ),
    "neutrosophic, spread": (neutrosophic.estimate, NEUTROSOPHIC, SIZES),
    "neutrosophic, scaled": (
        functools.partial(
            neutrosophic.estimate, rules=Rules(scale="covariance", share_measurement=False)
        ),
        NEUTROSOPHIC,
        SIZES,
    ),
    "neutrosophic, soft": (
        lambda scans, params, sizes: neutrosophic.soft_estimate(scans, *params, sizes=sizes),
        (NEUTROSOPHIC, 0.1),
        SIZES,
    ),
}
# These differ from others by a rule or two, and compile as long.
VARIANTS = (
    "neutrosophic, own cell",
    "neutrosophic, both cells",
    "neutrosophic, scaled",
    "improved, smoothed",
)
every_estimator = pytest.mark.parametrize(
    "name",
    [
        pytest.param(name, marks=pytest.mark.slow) if name in VARIANTS else name
        for name in ESTIMATORS
    ],
)


traces = collections.Counter()


@functools.cache
def run(name):
    estimate, _, sizes = ESTIMATORS[name]

    def counted(scans, params):
        traces[name] += 1
        return estimate(scans, params, sizes=sizes)

    return jax.jit(counted)


def looks(seed=0):
    """Return looks with a missing detection, NaN behind its mask."""
    scans = random_looks(np.random.default_rng(seed), LOOKS, SIZE)
    scans.mask[1, 3] = False
    scans.position_m[1, 3] = np.nan
    return scans


def assert_same(got, expected):
    """Check lines, taking those across the seam for what they are."""
    np.testing.assert_array_equal(got.mask, expected.mask)
    np.testing.assert_allclose(got.votes, expected.votes, rtol=1e-9, atol=1e-12)
    for n in np.flatnonzero(got.mask):
        pair = [(float(x.rho_m[n]), float(x.theta_rad[n])) for x in (got, expected)]
        np.testing.assert_allclose(lines.difference(*pair[0], *pair[1]), 0.0, atol=1e-6)


@every_estimator
def test_order_of_detections_changes_nothing(name):
    scans, params = looks(), ESTIMATORS[name][1]
    expected, info = run(name)(scans, params)
    assert int(expected.mask.sum()) >= 2
    order = np.argsort(np.random.default_rng(1).random((LOOKS, SIZE)), axis=1)
    shuffle = lambda x: (
        np.take_along_axis(x, order.reshape(order.shape + (1,) * (x.ndim - 2)), 1)
        if x.ndim > 1
        else x
    )
    got, shuffled = run(name)(jax.tree.map(shuffle, scans), params)
    assert_same(got, expected)
    members = np.take_along_axis(np.asarray(info.members), order[None], axis=2)
    np.testing.assert_array_equal(shuffled.members, members)


@every_estimator
def test_padding_changes_nothing(name):
    scans, params = looks(), ESTIMATORS[name][1]
    expected, info = run(name)(scans, params)
    pad = lambda x, value: (
        x
        if x.ndim == 1
        else np.concatenate([x, np.full((LOOKS, 1, *x.shape[2:]), value, x.dtype)], axis=1)
    )
    padded = jax.tree.map(lambda x: pad(x, np.nan if x.dtype == float else False), scans)
    got, more = run(name)(padded, params)
    assert_same(got, expected)
    np.testing.assert_array_equal(more.members[..., :SIZE], info.members)
    assert not more.members[..., SIZE:].any()


@every_estimator
def test_a_look_that_is_none_says_nothing(name):
    scans, params = looks(), ESTIMATORS[name][1]
    masked, lost = looks(), looks()
    masked.mask[2] = False
    lost.valid[2] = False
    for field in ("position_m", "weight", "delay_s"):
        getattr(lost, field)[2] = np.nan
    (expected, info), (got, other) = (run(name)(s, params) for s in (masked, lost))
    assert_same(got, expected)
    np.testing.assert_array_equal(other.members, info.members)
    assert not other.members[:, 2].any()
    assert (got.votes != run(name)(scans, params)[0].votes).any()


@every_estimator
def test_no_weight_is_no_detection_and_no_weights_are_ones(name):
    params = ESTIMATORS[name][1]
    masked, weightless = looks(), looks()
    masked.mask[2, :2] = False
    weightless.weight[2, :2] = 0.0  # pyright: ignore[reportOptionalSubscript]
    assert_same(run(name)(weightless, params)[0], run(name)(masked, params)[0])
    ones = looks()
    ones.weight[:] = 1.0  # pyright: ignore[reportOptionalSubscript]
    assert_same(run(name)(looks()._replace(weight=None), params)[0], run(name)(ones, params)[0])


@every_estimator
def test_vmap_is_a_loop(name):
    several, params = [looks(seed) for seed in range(3)], ESTIMATORS[name][1]
    stacked = jax.tree.map(lambda *x: np.stack(x), *several)
    got, info = jax.jit(jax.vmap(run(name), (0, None)))(stacked, params)
    for n, scans in enumerate(several):
        expected, alone = run(name)(scans, params)
        assert_same(jax.tree.map(lambda x, n=n: x[n], got), expected)
        np.testing.assert_array_equal(info.members[n], alone.members)


@every_estimator
def test_new_values_do_not_trace_again(name):
    params = ESTIMATORS[name][1]
    run(name)(looks(), params)
    before = traces[name]
    for seed, factor in ((1, 1.1), (2, 1.2)):
        run(name)(looks(seed), jax.tree.map(lambda x, f=factor: x * f, params))
    assert traces[name] == before > 0


@every_estimator
def test_single_precision_stays_single_and_finite(name):
    params = ESTIMATORS[name][1]
    single = jax.tree.map(lambda x: x.astype(np.float32) if x.dtype == float else x, looks())
    got, info = run(name)(single, params)
    for x in (*got[:3], info.relative_votes):
        assert x.dtype == np.float32
        assert np.isfinite(x).all()
    expected, _ = run(name)(looks(), params)
    np.testing.assert_allclose(got.votes[0], expected.votes[0], rtol=0.01)


@every_estimator
def test_extreme_looks_have_finite_lines(name):
    params = ESTIMATORS[name][1]
    full = random_looks(np.random.default_rng(5), LOOKS, SIZE)
    empty = full._replace(mask=np.zeros_like(full.mask), position_m=full.position_m * np.nan)
    coincident = full._replace(position_m=np.full_like(full.position_m, 7.0))
    straight = full._replace(position_m=full.position_m * [1.0, 0.0])
    frozen = full._replace(time_s=np.zeros(LOOKS), delay_s=full.delay_s * 0.0)
    for case in (full, empty, coincident, straight, frozen):
        got, info = run(name)(case, params)
        assert all(np.isfinite(x).all() for x in (*got[:3], info.relative_votes))
    got, info = run(name)(empty, params)
    assert not got.mask.any()
    assert not info.members.any()
    np.testing.assert_array_equal(got.votes, 0.0)


VOTES, QUERIES = 9, 6
# name: (kernel(tolerances, scales, mask, dtype), tolerances)
KERNELS = {
    "hard": lambda eps, scale, mask, dtype: hard(GRID, SIZES, dtype),
    "smoothed": lambda eps, scale, mask, dtype: hard(GRID, SMOOTH, dtype),
    "soft": lambda eps, scale, mask, dtype: soft(GRID, SIZES, *eps, dtype),
    "gaussian": lambda eps, scale, mask, dtype: gaussian(*eps),
    "scaled gaussian": lambda eps, scale, mask, dtype: scaled_gaussian(scale, mask),
}
every_kernel = pytest.mark.parametrize("name", KERNELS)


def kernel_value(name, rho, theta, votes, eps, scale):
    kernel = KERNELS[name](eps, scale, votes.mask, rho.dtype)
    return evaluate(rho, theta, votes, kernel)


@functools.cache
def read(name):
    return jax.jit(functools.partial(kernel_value, name))


def votes_and_queries(seed=0, dtype=np.float64):
    rng = np.random.default_rng(seed)
    rho, theta = rng.normal(scale=30.0, size=VOTES), rng.uniform(0.5, 0.7, VOTES)
    mask = np.arange(VOTES) != 4
    hide = lambda x: jnp.asarray(np.where(mask, x, np.nan), dtype)
    votes = Votes(hide(rho), hide(theta), hide(rng.uniform(0.2, 1.0, VOTES)), jnp.asarray(mask))
    scale = np.tile([400.0, 0.5, 0.01], (VOTES, 1)) * rng.uniform(0.5, 2.0, (VOTES, 1))
    at = [jnp.asarray(x[:QUERIES] * (1.0 + 1e-3), dtype) for x in (rho[::-1], theta[::-1])]
    eps = [jnp.asarray(x, dtype) for x in (20.0, 0.1)]
    return *at, votes, eps, jnp.asarray(np.where(mask[:, None], scale, np.nan), dtype)


def same(got, expected):
    np.testing.assert_allclose(got, expected, rtol=1e-12, atol=1e-14)


@every_kernel
def test_kernels_know_neither_order_nor_padding(name):
    rho, theta, votes, eps, scale = votes_and_queries()
    expected = read(name)(rho, theta, votes, eps, scale)
    assert (np.asarray(expected) > 0.0).any()
    order = np.random.default_rng(1).permutation(VOTES)
    shuffled = jax.tree.map(lambda x: x[order], votes)
    same(read(name)(rho, theta, shuffled, eps, scale[order]), expected)
    pad = lambda x: jnp.pad(x, (0, 3), constant_values=False if x.dtype == bool else jnp.nan)
    longer = jnp.pad(scale, ((0, 3), (0, 0)), constant_values=jnp.nan)
    same(read(name)(rho, theta, jax.tree.map(pad, votes), eps, longer), expected)


@every_kernel
def test_kernels_are_linear_in_the_weights(name):
    rho, theta, votes, eps, scale = votes_and_queries()
    expected = read(name)(rho, theta, votes, eps, scale)
    same(read(name)(rho, theta, votes._replace(weight=3 * votes.weight), eps, scale), 3 * expected)
    none = votes._replace(weight=votes.weight.at[2].set(0.0))
    masked = votes._replace(mask=votes.mask.at[2].set(False))
    same(*(read(name)(rho, theta, v, eps, scale) for v in (none, masked)))
    nobody = votes._replace(mask=jnp.zeros(VOTES, bool))
    same(read(name)(rho, theta, nobody, eps, scale), 0.0)


@every_kernel
def test_kernels_vmap_as_a_loop_and_compile_once(name):
    chex.clear_trace_counter()
    once = chex.assert_max_traces(lambda *case: kernel_value(name, *case), n=1)
    run_once = jax.jit(once)
    several = [votes_and_queries(seed) for seed in range(3)]
    alone = [run_once(*case) for case in several]
    stacked = jax.tree.map(lambda *x: jnp.stack(x), *several)
    same(jax.jit(jax.vmap(functools.partial(kernel_value, name)))(*stacked), jnp.stack(alone))


@every_kernel
def test_kernels_run_in_single_precision(name):
    got = read(name)(*votes_and_queries(dtype=np.float32))
    assert got.dtype == np.float32
    np.testing.assert_allclose(got, read(name)(*votes_and_queries()), rtol=1e-4, atol=1e-5)


@every_kernel
def test_coincident_votes_add_up(name):
    rho, theta, votes, eps, scale = votes_and_queries()
    votes = Votes(*(jnp.full(VOTES, x) for x in (3.0, 0.52, 1.0)), jnp.ones(VOTES, bool))
    got = read(name)(rho * 0 + 3.0, theta * 0 + 0.52, votes, eps, jnp.ones_like(scale) * scale[:1])
    assert np.isfinite(got).all()
    one = votes._replace(mask=jnp.arange(VOTES) == 0)
    alone = read(name)(rho * 0 + 3.0, theta * 0 + 0.52, one, eps, jnp.ones_like(scale) * scale[:1])
    np.testing.assert_allclose(got, VOTES * alone, rtol=1e-12)
    assert (alone > 0.0).all()
