"""Windows around many centres, the sums behind the moments, and features."""

import functools

import chex
import jax
import jax.numpy as jnp
import numpy as np
import pytest

from jaxtrack import moments
from jaxtrack.moments.totals import totals
from tests.metrics.differences import assert_gradients_agree

P, N, RADIUS = 40, 5, 1.5
ORDERS = moments.LOW_ORDERS


def scene(seed, kind="plain"):
    """Return points and weights in a field, and centres around its middle."""
    rng = np.random.default_rng(seed)
    xy, weight = rng.uniform(-5.0, 5.0, (P, 2)), rng.uniform(0.2, 2.0, P)
    centres = rng.normal(size=(N, 2))
    if kind == "holes":
        xy[::7], xy[1, 1], weight[2], weight[3], weight[4] = np.nan, np.inf, 0.0, np.nan, -1.0
        centres[1] = np.nan
    if kind == "alike":
        xy[:], centres[:] = xy[0], xy[0]
    if kind == "empty":
        centres += 100.0
    return xy, weight, centres


KINDS = ("plain", "holes", "alike", "empty")
windowed = jax.jit(functools.partial(moments.windowed, radius=RADIUS), static_argnames="most")
whole = jax.jit(lambda xy, weight: moments.inside(xy, weight, radius=RADIUS))


def held(xy, weight):
    """The points that count, as a set."""
    xy, weight = np.asarray(xy), np.asarray(weight)
    return sorted((*point, w) for point, w in zip(xy, weight, strict=True) if w > 0)


@pytest.mark.parametrize("kind", KINDS)
def test_windows_hold_what_the_disc_holds_while_there_is_room(kind):
    for seed in range(5):
        xy, weight, centres = scene(seed, kind)
        near = set()
        every = []
        for centre in centres:
            every.append(held(*whole(xy - centre, weight)))
            square = ((xy - centre) ** 2).sum(-1)
            near |= set(np.flatnonzero((square <= RADIUS**2) & (weight > 0)))
        for most in (P, max(len(near), 1)):
            got = windowed(xy, weight, centres, most=most)
            assert not got.overflow
            assert got.xy.shape == (N, most, 2)
            for n in range(N):
                assert held(got.xy[n], got.weight[n]) == every[n]
            assert np.isfinite(got.xy).all()
        if len(near) > 1:
            assert windowed(xy, weight, centres, most=len(near) - 1).overflow
    assert any(every) == (kind != "empty")


def test_places_beyond_the_points_are_none():
    xy, weight, centres = scene(0)
    more, all_ = windowed(xy, weight, centres, most=P + 3), windowed(xy, weight, centres, most=P)
    chex.assert_trees_all_equal(more, all_)
    none = windowed(xy[:0], weight[:0], centres, most=3)
    assert none.weight.shape == (N, 0)
    assert not none.overflow


def test_moments_of_windows_are_moments_about_the_centres():
    xy, weight, centres = scene(1)
    windows = windowed(xy, weight, centres, most=24)
    assert not windows.overflow
    zernike = functools.partial(moments.zernike, orders=ORDERS, radius=RADIUS)
    got = jax.jit(jax.vmap(zernike))(windows.xy, windows.weight)
    of_all = jax.jit(zernike)
    for one, centre in zip(got, centres, strict=True):
        np.testing.assert_allclose(one, of_all(xy - centre, weight), rtol=0, atol=1e-14)
    invariants = jax.jit(jax.vmap(moments.hu))(windows.xy, windows.weight)
    for one, centre in zip(invariants, centres, strict=True):
        near = ((xy - centre) ** 2).sum(-1) <= RADIUS**2
        expected = jax.jit(moments.hu)(xy, np.where(near, weight, 0.0))
        np.testing.assert_allclose(one, expected, rtol=1e-9, atol=1e-14)


def test_gradients_through_windows_are_right():
    def loss(xy, weight, centres):
        windows = moments.windowed(xy, weight, centres, radius=RADIUS, most=24)
        soft = functools.partial(moments.soft_zernike, orders=ORDERS, radius=RADIUS, taper=0.5)
        found = jax.vmap(soft)(windows.xy, windows.weight)
        return moments.soft_log_features(found, 1e-4).sum()

    gradients = assert_gradients_agree(loss, *scene(2), step=1e-6, rtol=1e-5, atol=1e-6)
    assert all(np.abs(gradient).max() > 1e-2 for gradient in gradients)


@pytest.mark.parametrize("kind", KINDS)
def test_gradients_through_windows_are_finite(kind):
    @jax.jit
    def gradient(xy, weight, centres):
        def loss(*points):
            windows = moments.windowed(*points, radius=RADIUS, most=6)
            zernike = functools.partial(moments.zernike, orders=ORDERS, radius=RADIUS)
            found = jax.vmap(zernike)(windows.xy, windows.weight)
            return moments.soft_log_features(found, 1e-6).sum()

        return jax.value_and_grad(loss, (0, 1, 2))(xy, weight, centres)

    for dtype in (np.float32, np.float64):
        found = gradient(*(x.astype(dtype) for x in scene(3, kind)))
        assert all(np.isfinite(leaf).all() for leaf in jax.tree.leaves(found))
        assert all(leaf.dtype == dtype for leaf in jax.tree.leaves(found))


def test_sums_and_their_gradients_to_the_second_order():
    rng = np.random.default_rng(0)
    x, y = rng.normal(size=(2, 3, P))
    for got, term in zip(jax.jit(totals)(x, y), (x, y), strict=True):
        np.testing.assert_allclose(got, term.sum(-1), rtol=1e-12, atol=1e-12)

    def loss(x, y):
        first, second = totals(x * y, x**3)
        return (first**2 * second).sum()

    def plain(x, y):
        return ((x * y).sum(-1) ** 2 * (x**3).sum(-1)).sum()

    x, y = x[0, :4], y[0, :4]
    assert_gradients_agree(loss, x, y, rtol=1e-6, atol=1e-7)
    for derivative in (jax.hessian, jax.jacfwd):
        np.testing.assert_allclose(
            jax.jit(derivative(loss))(x, y), jax.jit(derivative(plain))(x, y), rtol=1e-10
        )


def test_features():
    some = jnp.array([1e-3 + 0j, 3 - 4j, 0.0])
    got = moments.log_features(some)
    np.testing.assert_allclose(got[:2], [3.0, np.log10(5.0)], rtol=1e-12)
    assert np.isfinite(got).all()
    np.testing.assert_allclose(moments.log_features(jnp.array([-1e-20, 1e2])), [20.0, 2.0])
    soft = moments.soft_log_features(some, 1e-12)
    np.testing.assert_allclose(soft, [-3.0, np.log10(5.0), -6.0], atol=1e-6)
    # Where |I| < 1 the soft one tends to minus the hard one.
    small = jnp.array([1e-3, -2e-9, 1e-20])
    errors = [
        np.abs(moments.soft_log_features(small, eps) + moments.log_features(small)).max()
        for eps in (1e-6, 1e-18, 1e-30, 1e-60)
    ]
    assert errors[0] > errors[1] > errors[2] > 1.0 > 1e-12 > errors[3]
    assert jax.jit(moments.soft_log_features)(np.zeros(3, np.float32), 1e-80).dtype == np.float32

    def loss(parts, eps):
        return moments.soft_log_features(jax.lax.complex(parts[0], parts[1]), eps).sum()

    assert_gradients_agree(loss, np.array([[0.3, -2.0, 0.01], [0.1, 0.0, 0.02]]), 0.01, step=1e-6)
    for features in (moments.log_features, lambda x: moments.soft_log_features(x, 1e-12)):
        slope = jax.jit(jax.grad(lambda x, f=features: f(x).sum()))(jnp.array([0.0, 1.0, -2.0]))
        assert np.isfinite(slope).all()
    with pytest.raises(ValueError, match="eps: got 0"):
        moments.soft_log_features(some, 0.0)


def test_errors_name_the_argument():
    xy, weight, centres = scene(0)
    with pytest.raises(ValueError, match=r"centres: got shape \[5\], want \[N, 2\]"):
        moments.windowed(xy, weight, centres[:, 0], radius=1.0, most=3)
    with pytest.raises(TypeError, match="most: got float"):
        moments.windowed(xy, weight, centres, radius=1.0, most=3.0)
    with pytest.raises(ValueError, match="radius: got -1"):
        moments.windowed(xy, weight, centres, radius=-1.0, most=3)
