"""Zernike moments: against loops with fractions, mahotas, and what their docstrings promise."""

import functools
import math

import chex
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from mahotas.features import zernike_moments

from jaxtrack import moments
from jaxtrack.moments import LOW_ORDERS, PAPER_ORDERS
from tests.metrics.differences import assert_gradients_agree
from tests.oracles import moments as oracle

P = 12
TO_NINE = tuple((n, m) for n in range(10) for m in range(n % 2, n + 1, 2))
TO_FORTY = tuple((n, m) for n in range(41) for m in range(n % 2, n + 1, 2))
MIXED = ((0, 0), (12, 4), (4, -2), (1, 1), (17, -17))
several = settings(max_examples=25, deadline=None, derandomize=True, database=None)


@functools.cache
def compiled(orders):
    one = functools.partial(moments.zernike, orders=orders)
    return jax.jit(lambda xy, weight, radius: one(xy, weight, radius=radius))


def cloud(seed, kind="plain"):
    """Return points [P, 2] in and out of a disc of radius 2.5, and their weights."""
    rng = np.random.default_rng(seed)
    xy, weight = rng.uniform(-2.2, 2.2, (P, 2)), rng.uniform(0.2, 2.0, P)
    if kind == "holes":
        xy[0], xy[1, 1], weight[2], weight[3], weight[4] = np.nan, np.inf, 0.0, np.nan, -1.0
    if kind == "alike":
        xy[:] = xy[0]
    if kind == "origin":
        xy[:] = 0.0
    if kind == "edge":
        xy[:] = [[1.5, 2.0], [2.5, 0.0], [0.7, -2.4]] * (P // 3)
    if kind == "far":
        xy += 50.0
    if kind == "weightless":
        weight[:] = 0.0
    return xy, weight


KINDS = ("plain", "holes", "alike", "origin", "edge", "far", "weightless")
clouds = st.builds(cloud, st.integers(0, 2**32 - 1), st.sampled_from(KINDS))


@several
@given(clouds, st.sampled_from((PAPER_ORDERS, LOW_ORDERS, MIXED)))
def test_moments_equal_the_loops(points, orders):
    got = compiled(orders)(*points, 2.5)
    expected = [oracle.zernike(*points, n, m, 2.5) for n, m in orders]
    np.testing.assert_allclose(got, expected, rtol=1e-12, atol=1e-12)


@several
@given(clouds, st.sampled_from((1e-3, 0.3, 1.0)))
def test_soft_moments_equal_the_loops(points, taper):
    got = softly(*points, 2.5, taper)
    expected = [oracle.zernike(*points, n, m, 2.5, taper) for n, m in PAPER_ORDERS]
    np.testing.assert_allclose(got, expected, rtol=1e-9, atol=1e-9)


@jax.jit
def softly(xy, weight, radius, taper):
    return moments.soft_zernike(xy, weight, orders=PAPER_ORDERS, radius=radius, taper=taper)


@pytest.mark.parametrize("orders", [TO_NINE, (*TO_NINE, (10, 0))], ids=["explicit", "recurrent"])
def test_images_agree_with_mahotas(orders):
    run = jax.jit(functools.partial(moments.zernike_image, orders=orders))
    for seed in range(20):
        rng = np.random.default_rng(seed)
        image = np.where(rng.random((23, 19)) < 0.3, rng.uniform(0.1, 9.0, (23, 19)), 0.0)
        # Whole radii with pixels on the edge among them: 3² + 4² = 5².
        row, column, radius = 11.0, 9.0, 5.0
        if seed % 2:
            row, column, radius = rng.uniform(6, 16), rng.uniform(6, 13), rng.uniform(3.0, 12.0)
        got = run(image, np.array([column, row]), radius=radius)
        expected = zernike_moments(image, radius, degree=9, cm=(row, column))
        np.testing.assert_allclose(np.abs(got)[: len(TO_NINE)], expected, rtol=0, atol=1e-12)


@pytest.mark.parametrize(
    ("orders", "bound"), [(TO_NINE, 2e-6), (TO_FORTY, 2e-6)], ids=["to 9", "to 40"]
)
def test_radial_polynomials_in_single_precision(orders, bound):
    rho = np.linspace(0.0, 1.0, 61, dtype=np.float32)
    xy = np.stack([rho, np.zeros_like(rho)], axis=-1)[:, None]
    run = jax.jit(jax.vmap(compiled(orders), (0, None, None)))
    got = run(xy, np.ones(1, np.float32), np.float32(1.0))
    assert got.dtype == np.complex64
    # The moment of one point is its polynomial.
    got = np.asarray(got).astype(complex) * math.pi / np.array([n + 1 for n, _ in orders])
    expected = [[oracle.radial(n, m, one) for n, m in orders] for one in rho]
    np.testing.assert_allclose(got, expected, rtol=0, atol=bound)


def test_turning_mirroring_and_scaling():
    xy, weight = cloud(1)
    orders = (*TO_NINE, (12, 4), (13, -5))
    m = np.array([m for _, m in orders])
    run = compiled(orders)
    base = np.asarray(run(xy, weight, 2.5))
    assert np.abs(base).min() > 1e-3
    for angle in (0.4, 2.1, -3.0):
        turn = np.array([[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]])
        turned = run(xy @ turn.T, weight, 2.5)
        np.testing.assert_allclose(np.abs(turned), np.abs(base), rtol=0, atol=1e-13)
        np.testing.assert_allclose(turned, base * np.exp(-1j * m * angle), rtol=0, atol=1e-13)
    np.testing.assert_allclose(run(xy * [1.0, -1.0], weight, 2.5), base.conj(), atol=1e-14)
    np.testing.assert_allclose(run(xy * 1e3, weight * 1e-9, 2.5e3), base, rtol=0, atol=1e-13)
    moved = run(xy + 0.1, weight, 2.5)
    assert np.abs(np.abs(moved) - np.abs(base)).max() > 1e-2


def test_centrosymmetric_points_have_none_of_the_papers_moments():
    xy, weight = cloud(2)
    both, twice = np.concatenate([xy, -xy]), np.tile(weight, 2)
    np.testing.assert_allclose(compiled(PAPER_ORDERS)(both, twice, 2.5), 0.0, atol=1e-14)
    assert np.abs(compiled(LOW_ORDERS)(both, twice, 2.5)).max() > 0.1


@pytest.mark.parametrize("orders", [PAPER_ORDERS, MIXED], ids=["explicit", "recurrent"])
def test_order_padding_and_batches_change_nothing(orders):
    xy, weight = cloud(3)
    run = compiled(orders)
    base = run(xy, weight, 2.5)
    order = np.random.default_rng(0).permutation(P)
    np.testing.assert_allclose(run(xy[order], weight[order], 2.5), base, rtol=0, atol=1e-14)
    padded = np.concatenate([xy, np.full((3, 2), np.nan)]), np.append(weight, [0.0, 1.0, np.nan])
    np.testing.assert_allclose(run(*padded, 2.5), base, rtol=0, atol=1e-14)
    batch = [np.stack(rows) for rows in zip(*(cloud(seed) for seed in range(4)), strict=True)]
    together = jax.jit(jax.vmap(run, (0, 0, None)))(*batch, 2.5)
    for one, xy, weight in zip(together, *batch, strict=True):
        np.testing.assert_allclose(one, run(xy, weight, 2.5), rtol=0, atol=1e-14)


def test_one_trace_for_all_values():
    @jax.jit
    @chex.assert_max_traces(n=1)
    def run(xy, weight, radius):
        return moments.zernike(xy, weight, orders=LOW_ORDERS, radius=radius)

    for seed in range(3):
        run(*cloud(seed), 2.0 + seed)


def test_soft_tends_to_hard():
    xy, weight = cloud(4)
    xy = xy[np.abs(np.hypot(*xy.T) / 2.5 - 1) > 0.01]
    weight = weight[: len(xy)]
    hard = compiled(PAPER_ORDERS)(xy, weight, 2.5)
    np.testing.assert_allclose(softly(xy, weight, 2.5, 1e-6), hard, rtol=0, atol=1e-14)
    errors = [np.abs(softly(xy, weight, 2.5, t) - hard).max() for t in (0.6, 0.2, 0.005)]
    assert errors[0] > errors[1] > 1e-3
    assert errors[2] < 1e-14


def test_a_point_that_crosses_the_edge_is_a_step_of_the_hard_one_only():
    xy, weight = cloud(5)
    jumps = []
    for run in (lambda *x: compiled(PAPER_ORDERS)(*x, 2.5), lambda *x: softly(*x, 2.5, 0.3)):
        ends = []
        for rho in (2.5 - 1e-7, 2.5 + 1e-7):
            xy[0] = [rho, 0.0]
            # A copy: what is computed later might see what is written into it next.
            ends.append(np.asarray(run(xy.copy(), weight)))
        jumps.append(np.abs(ends[0] - ends[1]).max())
    assert jumps[0] > 1e-2
    assert jumps[1] < 1e-12


def squares(found):
    """A loss of moments to which real and imaginary parts contribute differently."""
    return (found.real**2 + 0.3 * found.real * found.imag + 2 * found.imag**2).sum()


@pytest.mark.parametrize("orders", [PAPER_ORDERS, MIXED], ids=["explicit", "recurrent"])
def test_gradients_are_right(orders):
    xy, weight = cloud(6, "holes")
    good = np.isfinite(xy).all(-1) & (weight > 0)
    hidden = np.where(good, 0.0, np.nan)
    xy = np.where(good[:, None], xy, 0.0)

    def loss(xy, weight, radius):
        points = xy + hidden[:, None], weight + hidden
        return squares(moments.zernike(*points, orders=orders, radius=radius))

    weight = np.where(good, weight, 1.0)
    assert_gradients_agree(loss, xy, weight, 2.5, step=1e-6, rtol=1e-6, atol=1e-7)


def test_gradients_of_soft_moments_are_right():
    def loss(xy, weight, radius, taper):
        soft = functools.partial(moments.soft_zernike, orders=LOW_ORDERS)
        return squares(soft(xy, weight, radius=radius, taper=taper))

    gradients = assert_gradients_agree(loss, *cloud(7), 2.5, 0.4, step=1e-6, atol=1e-7)
    assert all(np.abs(gradient).max() > 1e-3 for gradient in gradients)


@jax.jit
def gradient(xy, weight):
    def loss(xy, weight):
        soft = moments.soft_zernike(xy, weight, orders=PAPER_ORDERS, radius=2.5, taper=0.2)
        hard = moments.zernike(xy, weight, orders=MIXED, radius=2.5)
        return squares(soft) + squares(hard) + moments.soft_log_features(soft, 1e-12).sum()

    return jax.value_and_grad(loss, (0, 1))(xy, weight)


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("dtype", [np.float32, np.float64])
def test_nothing_is_nan_whatever_the_points(kind, dtype):
    xy, weight = (x.astype(dtype) for x in cloud(8, kind))
    for unit in (1.0, 1e-30, 1e30):
        found = gradient(xy, (weight * unit).astype(dtype))
        assert all(np.isfinite(leaf).all() for leaf in jax.tree.leaves(found))
    # What does not count has no gradient.
    outside = ~(np.hypot(*xy.T) <= 2.5) | ~(weight > 0)
    assert not found[1][0][outside].any()
    assert not found[1][1][outside].any()


def test_no_points_are_nothing():
    none = moments.zernike(jnp.zeros((0, 2)), jnp.zeros(0), orders=PAPER_ORDERS, radius=1.0)
    np.testing.assert_array_equal(none, np.zeros(7))


def test_errors_name_the_argument():
    xy, weight = cloud(0)
    run = functools.partial(moments.zernike, orders=PAPER_ORDERS, radius=1.0)
    with pytest.raises(ValueError, match=r"xy: got shape \[12\], want \[P, 2\]"):
        run(xy[:, 0], weight)
    with pytest.raises(ValueError, match=r"weight: got shape \[3\], want \[12\]"):
        run(xy, weight[:3])
    with pytest.raises(ValueError, match="radius: got 0"):
        run(xy, weight, radius=0.0)
    for wrong in ((3, 2), (2, 4), (42, 0)):
        with pytest.raises(ValueError, match=r"orders\[1\]: got .*, want \|m\| ≤ n ≤ 40"):
            run(xy, weight, orders=((1, 1), wrong))
    with pytest.raises(ValueError, match="number of orders: got 0"):
        run(xy, weight, orders=())
    with pytest.raises(TypeError, match=r"orders\[0\], n: got float"):
        run(xy, weight, orders=((1.0, 1),))
    for wrong in (0.0, 1.5, float("nan")):
        with pytest.raises(ValueError, match="taper: got"):
            moments.soft_zernike(xy, weight, orders=LOW_ORDERS, radius=1.0, taper=wrong)
    with pytest.raises(ValueError, match=r"image: got shape \[3\], want \[H, W\]"):
        moments.image_points(weight[:3])
    with pytest.raises(ValueError, match=r"centre: got shape \[3\]"):
        moments.zernike_image(xy, weight[:3], orders=LOW_ORDERS, radius=1.0)
