"""Linked clusters against a walk from point to point; chains, masks, places and gradients."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from jaxtrack.clustering import linked
from tests.oracles import pings as oracle

run = jax.jit(linked, static_argnames="clusters")


def assert_same(found, expected, number):
    live = np.asarray(found.mask)
    assert live.sum() == len(expected)
    label = np.full(number, -1)
    for k, (members, mass, centre) in enumerate(expected):
        np.testing.assert_allclose(found.centre[k], centre, atol=1e-9)
        np.testing.assert_allclose(found.mass[k], mass, rtol=1e-12)
        assert found.count[k] == len(members)
        label[members] = k
    np.testing.assert_array_equal(found.label, label)
    for field in (found.centre, found.mass, found.count):
        assert not np.asarray(field)[~live].any()


@pytest.mark.parametrize("gap", [0.3, 0.8, 1.5])
def test_clusters_are_those_of_a_walk(gap):
    rng = np.random.default_rng(int(10 * gap))
    for _ in range(12):
        points, weights = rng.uniform(0.0, 10.0, (60, 2)), rng.uniform(0.1, 1.0, 60)
        for members in (1, 3):
            expected = oracle.linked(points, weights, [gap] * 60, members)
            found = run(
                jnp.asarray(points), gap, weights=jnp.asarray(weights), members=members, clusters=60
            )
            assert_same(found, expected, 60)
            assert not found.overflow


def test_of_two_points_the_larger_gap_counts():
    rng = np.random.default_rng(9)
    points, weights = rng.uniform(0.0, 10.0, (60, 2)), rng.uniform(0.1, 1.0, 60)
    gaps = rng.uniform(0.2, 1.3, 60)
    found = run(jnp.asarray(points), jnp.asarray(gaps), weights=jnp.asarray(weights), clusters=60)
    assert_same(found, oracle.linked(points, weights, gaps, 1), 60)
    with pytest.raises(ValueError, match=r"gap: got shape \[2\], want \[60\]"):
        linked(jnp.asarray(points), jnp.ones(2))


def test_long_chains_in_any_order_are_one_cluster():
    rng = np.random.default_rng(0)
    turn = np.linspace(0.0, 12.0, 300)
    spiral = np.stack([turn * np.cos(turn), turn * np.sin(turn)], axis=-1)
    for order in (np.arange(300), rng.permutation(300)):
        found = run(jnp.asarray(spiral[order]), 0.6, clusters=4)
        assert found.count.tolist() == [300, 0, 0, 0]
        np.testing.assert_allclose(found.centre[0], spiral.mean(axis=0), atol=1e-9)
    cut = run(jnp.asarray(np.delete(spiral, range(149, 152), axis=0)), 0.6, clusters=4)
    assert cut.mask.sum() == 2


def test_the_gap_itself_links():
    found = run(jnp.array([[0.0], [1.0], [2.0], [3.001]]), 1.0, clusters=3)
    assert found.label.tolist() == [0, 0, 0, 1]


def test_masks_permutation_padding_and_places():
    rng = np.random.default_rng(3)
    points, weights = rng.uniform(0.0, 6.0, (40, 2)), rng.uniform(0.1, 1.0, 40)
    mask = rng.uniform(size=40) < 0.7
    expected = oracle.linked(points[mask], weights[mask], [0.7] * 40, 2)
    dirty = jnp.asarray(np.where(mask[:, None], points, np.nan))
    heavy = jnp.asarray(np.where(mask, weights, np.nan))
    found = run(dirty, 0.7, weights=heavy, mask=jnp.asarray(mask), members=2, clusters=30)
    np.testing.assert_array_equal(np.asarray(found.label)[~mask], -1)
    assert_same(found._replace(label=found.label[mask]), expected, mask.sum())
    order = rng.permutation(40)
    again = run(
        dirty[order],
        0.7,
        weights=heavy[order],
        mask=jnp.asarray(mask[order]),
        members=2,
        clusters=30,
    )
    np.testing.assert_allclose(again.centre, found.centre, atol=1e-12)
    np.testing.assert_array_equal(again.label, found.label[order])
    few = run(dirty, 0.7, weights=heavy, mask=jnp.asarray(mask), members=2, clusters=3)
    assert (bool(few.overflow), bool(found.overflow)) == (len(expected) > 3, False)
    np.testing.assert_allclose(few.centre, found.centre[:3], atol=1e-12)
    assert few.overflow

    none = run(dirty, 0.7, mask=jnp.zeros(40, bool), clusters=3)
    assert (int(none.mask.sum()), set(none.label.tolist())) == (0, {-1})
    weightless = run(jnp.array([[0.0], [1.0]]), 1.0, weights=jnp.zeros(2), clusters=1)
    assert (float(weightless.centre[0, 0]), float(weightless.mass[0])) == (0.5, 0.0)
    many = run(jnp.array([[0.0], [9.0]]), 1.0, clusters=5)  # more places than points
    assert many.mask.tolist() == [True, True, False, False, False]


def test_vmap_float32_one_trace_and_gradients():
    rng = np.random.default_rng(4)
    points = jnp.asarray(rng.uniform(0.0, 6.0, (3, 40, 2)))
    traces = []

    @jax.jit
    def many(points, gap):
        traces.append(1)
        return jax.vmap(lambda x: linked(x, gap))(points)

    found = many(points, 0.7)
    many(points, 0.5)
    assert len(traces) == 1
    for n in range(3):
        one = run(points[n], 0.7)
        for x, y in zip(jax.tree.leaves(one), jax.tree.leaves(found), strict=True):
            np.testing.assert_allclose(x, y[n], atol=1e-12)
    small = many(points.astype(jnp.float32), 0.7)
    assert small.centre.dtype == jnp.float32
    np.testing.assert_array_equal(small.label, found.label)

    weights = jnp.asarray(rng.uniform(0.1, 1.0, 40))

    @jax.jit
    def total(points, weights):
        found = linked(points, 0.7, weights=weights)
        return jnp.sin(found.centre).sum() + (found.mass**2).sum()

    slopes = jax.jit(jax.grad(total, (0, 1)))
    got = slopes(points[0], weights)
    for n in (0, 7, 23):
        step = jnp.zeros((40, 2)).at[n, 0].set(1e-6)
        difference = total(points[0] + step, weights) - total(points[0] - step, weights)
        np.testing.assert_allclose(got[0][n, 0], difference / 2e-6, rtol=1e-5, atol=1e-9)
        difference = total(points[0], weights + step[:, 0]) - total(points[0], weights - step[:, 0])
        np.testing.assert_allclose(got[1][n], difference / 2e-6, rtol=1e-5, atol=1e-9)
    for at in (slopes(0 * points[0], weights), slopes(points[0], 0 * weights)):
        assert all(np.isfinite(np.asarray(x)).all() for x in at)


def test_wrong_arguments_are_named():
    with pytest.raises(ValueError, match=r"points: got shape \[4\], want \[N, D\]"):
        linked(jnp.zeros(4), 1.0)
    with pytest.raises(ValueError, match=r"gap: got -1.0, want a positive"):
        linked(jnp.zeros((4, 2)), -1.0)
    with pytest.raises(TypeError, match="mask: got dtype float64"):
        linked(jnp.zeros((4, 2)), 1.0, mask=jnp.ones(4))
    with pytest.raises(ValueError, match="clusters: got 0"):
        linked(jnp.zeros((4, 2)), 1.0, clusters=0)
