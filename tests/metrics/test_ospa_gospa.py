"""OSPA and GOSPA against brute force, the axioms of a metric, and their gradients."""

import functools
import math

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from jaxtrack.metrics import Gospa, Ospa, gospa, ospa
from tests.metrics.differences import assert_gradients_agree
from tests.oracles.gospa import gospa as gospa_oracle
from tests.oracles.ospa import ospa as ospa_oracle

SHAPES = ((6, 6, 2), (4, 6, 3), (5, 2, 1))  # M, N, D
ORDERS = (1.0, 1.5, 2.0, 3.0)
METRICS = {"ospa": (ospa, ospa_oracle), "gospa": (gospa, gospa_oracle)}
few = settings(max_examples=30, deadline=None, derandomize=True, database=None)


@functools.cache
def jitted(name):
    metric = METRICS[name][0]
    return jax.jit(
        lambda x, x_mask, y, y_mask, c, p: metric(x, x_mask, y, y_mask, cutoff=c, order=p)
    )


@st.composite
def scenes(draw, lattice=False):
    """Two padded sets with NaN behind the masks; on a lattice, where many distances are equal."""
    rows, columns, dimension = draw(st.sampled_from(SHAPES))
    rng = np.random.default_rng(draw(st.integers(0, 2**32 - 1)))
    sets = []
    for size in (rows, columns):
        mask = np.array(draw(st.lists(st.booleans(), min_size=size, max_size=size)))
        points = rng.normal(scale=8.0, size=(size, dimension))
        points = np.round(points / 5.0) * 5.0 if lattice else points
        sets += [np.where(mask[:, None], points, np.nan), mask]
    cutoff = draw(st.sampled_from((2.0, 10.0, 40.0)))
    return (*sets, cutoff, draw(st.sampled_from(ORDERS)))


def random_sets(seed, sizes, dimension=2):
    rng = np.random.default_rng(seed)
    return [rng.normal(scale=8.0, size=(size, dimension)) for size in sizes]


def everything(metric, estimates, truths, **params):
    present = (jnp.ones(len(estimates), bool), jnp.ones(len(truths), bool))
    return metric(jnp.asarray(estimates), present[0], jnp.asarray(truths), present[1], **params)


@few
@given(scenes())
def test_ospa_equals_brute_force(scene):
    x, x_mask, y, y_mask, cutoff, order = scene
    expected = ospa_oracle(x[x_mask], y[y_mask], cutoff, order)
    np.testing.assert_allclose(jitted("ospa")(*scene), expected, rtol=1e-11, atol=1e-12)


@few
@given(scenes())
def test_gospa_equals_brute_force(scene):
    x, x_mask, y, y_mask, cutoff, order = scene
    expected = gospa_oracle(x[x_mask], y[y_mask], cutoff, order)
    np.testing.assert_allclose(jitted("gospa")(*scene), expected, rtol=1e-11, atol=1e-12)


@pytest.mark.parametrize("name", METRICS)
@few
@given(scene=scenes(lattice=True))
def test_distance_equals_brute_force_at_equal_and_vanishing_distances(name, scene):
    x, x_mask, y, y_mask, cutoff, order = scene
    expected = METRICS[name][1](x[x_mask], y[y_mask], cutoff, order)[0]
    score = jitted(name)(*scene)
    assert float(score.distance) == pytest.approx(expected, rel=1e-11, abs=1e-12)
    parts = sum(float(part) ** order for part in score[1:])
    assert parts == pytest.approx(expected**order, rel=1e-11, abs=1e-12)


@pytest.mark.parametrize("name", METRICS)
@few
@given(scene=scenes(), seed=st.integers(0, 2**32 - 1))
def test_order_of_points_and_padding_change_nothing(name, scene, seed):
    x, x_mask, y, y_mask, cutoff, order = scene
    rng = np.random.default_rng(seed)
    rows, columns = rng.permutation(len(x)), rng.permutation(len(y))
    score = jitted(name)(*scene)
    shuffled = jitted(name)(x[rows], x_mask[rows], y[columns], y_mask[columns], cutoff, order)
    np.testing.assert_allclose(shuffled, score, rtol=1e-12, atol=1e-13)

    padding = np.full((3, x.shape[1]), np.nan)
    longer, longer_mask = np.concatenate([x, padding]), np.append(x_mask, [False] * 3)
    padded = jitted(name)(longer, longer_mask, y, y_mask, cutoff, order)
    np.testing.assert_allclose(padded, score, rtol=1e-12, atol=1e-13)


@pytest.mark.parametrize("order", ORDERS)
@pytest.mark.parametrize("name", METRICS)
def test_axioms_of_a_metric(name, order):
    rng = np.random.default_rng(7)
    trials, size = 300, 5
    # Many points are shared between the sets, or else the triangle is never nearly flat.
    pool = rng.normal(scale=6.0, size=(trials, 7, 2))
    points, masks = [], []
    for _ in range(3):
        drawn = np.argsort(rng.random((trials, 7)), axis=1)[:, :size]
        points.append(np.take_along_axis(pool, drawn[..., None], axis=1))
        masks.append(rng.random((trials, size)) < 0.7)
    score = jax.jit(jax.vmap(lambda *sets: jitted(name)(*sets, 10.0, order)))
    (x, y, z), (x_mask, y_mask, z_mask) = points, masks

    there, back = score(x, x_mask, y, y_mask), score(y, y_mask, x, x_mask)
    np.testing.assert_allclose(there.distance, back.distance, rtol=1e-12, atol=1e-12)
    if isinstance(there, Gospa) and isinstance(back, Gospa):
        np.testing.assert_allclose(there.missed, back.false, rtol=1e-12, atol=1e-12)
    np.testing.assert_array_equal(score(x, x_mask, x, x_mask).distance, 0.0)
    onward = score(y, y_mask, z, z_mask).distance
    direct = score(x, x_mask, z, z_mask).distance
    assert np.all(direct <= there.distance + onward + 1e-10)


def test_assignment_is_on_the_powered_distances():
    # Distances 0 and 4 one way, 2 and 3 the other: 4 < 5, but 16 > 4 + 9.
    estimates = [[0.0, 0.0], [3.0, 0.0]]
    truths = [[0.0, 0.0], [-0.5, 2.0 * math.sqrt(1 - 0.25**2)]]
    squared = everything(ospa, estimates, truths, cutoff=20.0, order=2.0)
    assert float(squared.distance) == pytest.approx(math.sqrt(13 / 2))
    plain = everything(ospa, estimates, truths, cutoff=20.0, order=1.0)
    assert float(plain.distance) == pytest.approx(4 / 2)


@pytest.mark.parametrize("order", ORDERS)
def test_empty_sets(order):
    points, empty = jnp.ones((2, 2)), jnp.zeros((0, 2))
    none, both = jnp.zeros(2, bool), jnp.ones(2, bool)
    nobody = Ospa(*map(jnp.asarray, (0.0, 0.0, 0.0)))
    params = {"cutoff": 20.0, "order": order}
    assert ospa(points, none, points, none, **params) == nobody
    assert everything(ospa, empty, empty, **params) == nobody
    for score in (
        ospa(points, none, points, both, **params),
        everything(ospa, empty, points, **params),
    ):
        np.testing.assert_allclose(score, (20.0, 0.0, 20.0), rtol=1e-14)
    two = 20.0 * (2 / 2) ** (1 / order)
    np.testing.assert_allclose(everything(gospa, empty, points, **params), (two, 0, two, 0))
    np.testing.assert_allclose(everything(gospa, points, empty, **params), (two, 0, 0, two))


def test_gospa_never_assigns_a_far_pair():
    score = everything(gospa, [[0.0], [100.0]], [[1.0], [50.0]], cutoff=10.0, order=1.0)
    np.testing.assert_allclose(score, (11.0, 1.0, 5.0, 5.0))


@pytest.mark.parametrize("order", ORDERS)
@pytest.mark.parametrize("name", METRICS)
def test_gradient_agrees_with_central_differences(name, order):
    x, y = random_sets(3, (3, 5))
    x_mask, y_mask = np.array([True, True, True]), np.array([True, False, True, True, True])

    def loss(x, y, cutoff, order):
        y = jnp.where(y_mask[:, None], y, jnp.nan)
        parts = METRICS[name][0](x, x_mask, y, y_mask, cutoff=cutoff, order=order)
        return sum(weight * part for weight, part in zip((1.0, 0.7, 0.3, 0.2), parts, strict=False))

    assert_gradients_agree(loss, x, y, 9.0, order)


@pytest.mark.parametrize("dtype", [jnp.float32, jnp.float64])
@pytest.mark.parametrize("order", [*ORDERS, 20.0])
@pytest.mark.parametrize("name", METRICS)
def test_value_and_gradient_are_finite_at_degenerate_input(name, order, dtype):
    def loss(x, x_mask, y, y_mask, cutoff, order):
        return sum(METRICS[name][0](x, x_mask, y, y_mask, cutoff=cutoff, order=order))

    gradient = jax.jit(jax.value_and_grad(loss, argnums=(0, 2, 4, 5)))
    both, none = np.ones(2, bool), np.zeros(2, bool)
    same = np.array([[1.0, 2.0], [1.0, 2.0]])
    nan = np.full((2, 2), np.nan)
    close = same + 1e-3
    edge = same + np.array([[10.0, 0.0]])
    scenes = (
        (same, both, same, both),
        (same, both, close, both),
        (same, both, edge, both),
        (same, both, nan, none),
        (nan, none, same, both),
        (nan, none, nan, none),
        (1e15 * same, both, same, both),
    )
    for x, x_mask, y, y_mask in scenes:
        scene = (jnp.asarray(x, dtype), x_mask, jnp.asarray(y, dtype), y_mask)
        results = gradient(*scene, jnp.asarray(10.0, dtype), jnp.asarray(order, dtype))
        for leaf in jax.tree.leaves(results):
            assert leaf.dtype == dtype
            assert np.all(np.isfinite(leaf))


@pytest.mark.parametrize("name", METRICS)
def test_float32(name):
    metric, oracle = METRICS[name]
    x, y = random_sets(5, (4, 6))
    score = everything(metric, x.astype(np.float32), y.astype(np.float32), cutoff=10.0, order=1.5)
    assert all(part.dtype == jnp.float32 for part in score)
    np.testing.assert_allclose(score, oracle(x, y, 10.0, 1.5), rtol=1e-5)


@pytest.mark.parametrize("name", METRICS)
def test_vmap_equals_loop(name):
    rng = np.random.default_rng(11)
    x, y = rng.normal(size=(8, 4, 2)), rng.normal(size=(8, 5, 2))
    x_mask, y_mask = rng.random((8, 4)) < 0.6, rng.random((8, 5)) < 0.6
    together = jax.vmap(lambda *sets: jitted(name)(*sets, 1.0, 2.0))(x, x_mask, y, y_mask)
    for trial in range(8):
        alone = jitted(name)(x[trial], x_mask[trial], y[trial], y_mask[trial], 1.0, 2.0)
        np.testing.assert_allclose([part[trial] for part in together], alone, rtol=1e-13)


@pytest.mark.parametrize("metric", [ospa, gospa])
def test_errors_name_the_argument(metric):
    points, mask = jnp.zeros((3, 2)), jnp.ones(3, bool)
    params = {"cutoff": 1.0, "order": 2.0}
    with pytest.raises(ValueError, match="estimates: got shape"):
        metric(points[0], mask, points, mask, **params)
    with pytest.raises(ValueError, match="estimates_mask: got shape"):
        metric(points, mask[:2], points, mask, **params)
    with pytest.raises(ValueError, match="truths: got shape"):
        metric(points, mask, points[:, :1], mask, **params)
    with pytest.raises(ValueError, match="cutoff: got shape"):
        metric(points, mask, points, mask, cutoff=jnp.ones(2), order=2.0)
    with pytest.raises(TypeError, match="order"):
        metric(points, mask, points, mask, cutoff=1.0, order="two")


@pytest.mark.parametrize(
    ("option", "value"),
    [("cutoff", 0.0), ("cutoff", -5.0), ("cutoff", np.inf), ("order", 0.5), ("order", np.inf)],
)
def test_known_cutoffs_and_orders_out_of_range_are_refused(option, value):
    points, mask = jnp.zeros((1, 2)), jnp.ones(1, bool)
    with pytest.raises(ValueError, match=f"{option}: got .*, want a"):
        METRICS["ospa"][0](
            points, mask, points, mask, **{"cutoff": 5.0, "order": 2.0, option: value}
        )
