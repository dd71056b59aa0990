import functools

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from jaxtrack.tracking import ShapeParams, shape_template, shape_tracker
from jaxtrack.tracking.shape_tracker import shape_features, shape_log_likelihood
from jaxtrack.types import Scan
from tests.metrics.differences import assert_gradients_agree
from tests.oracles import shape_tracker as oracle

T, P = 16, 48
OTHER = np.array([5.5, 4.6])  # of a look-alike beside the path, in the middle of it


def clouds(seed=0, speed_m_s=0.05, looks=T, dtype=float, other=True):
    """Return an arc of 20 points that moves along x, a look-alike 1.6 m off, and others far off."""
    rng = np.random.default_rng(seed)
    arc = lambda: (
        np.stack([0.4 * np.cos(t := rng.uniform(2, 4.3, 20)), 0.4 * np.sin(t)], -1)
        + 0.03 * rng.normal(size=(20, 2))
    )
    time_s = 6.0 * np.arange(looks)
    places = np.stack([4 + speed_m_s * time_s, 3 + 0 * time_s], -1)
    one, two = arc(), arc()
    own = places[:, None] + one[None] + 0.01 * rng.normal(size=(looks, 20, 2))
    beside = np.broadcast_to(OTHER + two, (looks, 20, 2)) + (0 if other else 50)
    far = rng.uniform(20, 30, (looks, P - 40, 2))
    at = np.concatenate([own, beside, far], 1).astype(dtype)
    weight = rng.uniform(0.5, 1.0, (looks, P)).astype(dtype)
    ones = np.ones((looks, P), bool)
    scans = Scan(time_s.astype(dtype), np.ones(looks, bool), at, ones, weight=weight)
    return scans, places.astype(dtype)


@functools.partial(jax.jit, static_argnames="particles")
def run(key, scans, places, particles=120):
    template = shape_template(jax.tree.map(lambda x: x[:3], scans), places[:3])
    tracker = shape_tracker(template, particles=particles)
    later = jax.tree.map(lambda x: x[3:], scans)
    state, info = jax.lax.scan(tracker.step, tracker.init(key), later)
    return template, state, info


def errors(info, places):
    return np.linalg.norm(np.asarray(info.position_m) - places[..., 3:, :], axis=-1)


def test_template_and_likelihood_are_the_oracles():
    scans, places = clouds()
    params = ShapeParams(taper=0.4, sigma=0.5, mass_sigma=0.7, floor=0.02)
    first = jax.tree.map(lambda x: x[:3], scans)
    template = jax.jit(shape_template)(first, places[:3], params)
    frames = list(zip(scans.position_m[:3], scans.weight[:3], strict=True))
    wanted, wanted_mass = oracle.template(frames, places[:3], 1.0, 0.4)
    np.testing.assert_allclose(template.moments, wanted, atol=1e-12)
    np.testing.assert_allclose(template.mass, wanted_mass, rtol=1e-12)
    np.testing.assert_allclose(template.velocity_m_s, [0.05, 0.0], atol=1e-12)
    np.testing.assert_allclose(template.place_m, places[2], atol=1e-12)

    look = jax.tree.map(lambda x: x[5], scans)
    rng = np.random.default_rng(1)
    centres = np.concatenate([places[5] + 0.5 * rng.normal(size=(20, 2)), [[-50.0, 0.0]]])

    @jax.jit
    def told(centres):
        moments, mass, overflow = shape_features(look, centres, params, most=P)
        return shape_log_likelihood(moments, mass, template, params), overflow

    ours, overflow = told(centres)
    want = [
        oracle.likelihood(
            *oracle.features(look.position_m, look.weight, at, 1.0, 0.4),
            wanted, wanted_mass, 0.5, 0.7, 0.02,
        )
        for at in centres
    ]  # fmt: skip
    np.testing.assert_allclose(ours, np.log(want), atol=1e-10)
    np.testing.assert_allclose(want[-1], 0.02)
    assert max(want) > 0.1
    assert not overflow
    assert shape_features(look, centres, params, most=3)[2]


def test_the_likelihood_has_the_gradients_of_differences():
    scans, places = clouds(1)
    params = ShapeParams()
    template = shape_template(jax.tree.map(lambda x: x[:3], scans), places[:3])
    look = jax.tree.map(lambda x: x[4], scans)

    def loss(at):
        moments, mass, _ = shape_features(look, at, params, most=P)
        return shape_log_likelihood(moments, mass, template, params).sum()

    at = places[4] + np.array([[0.2, 0.1], [-0.1, 0.3], [40.0, 40.0]])
    assert_gradients_agree(jax.jit(loss), jnp.asarray(at))


def test_it_passes_a_look_alike_beside_the_path():
    scans, places = clouds(2)
    many = jax.random.split(jax.random.key(0), 32)
    _, _, info = jax.vmap(lambda key: run(key, scans, places))(many)
    error = errors(info, places)
    assert np.median(error) < 0.15
    assert (error[:, -5:].mean(1) < 0.5).mean() >= 0.9
    assert not info.overflow.any()
    assert np.abs(np.median(info.velocity_m_s[:, -1], axis=0) - [0.05, 0]).max() < 0.03


def test_a_target_out_of_sight_for_a_while_is_found_again():
    scans, places = clouds(3, speed_m_s=0.0, looks=40, other=False)
    gone = (np.arange(40) >= 10) & (np.arange(40) < 30)
    scans = scans._replace(mask=scans.mask & ~gone[:, None])
    many = jax.random.split(jax.random.key(1), 16)
    _, _, info = jax.vmap(lambda key: run(key, scans, places))(many)
    assert jnp.isfinite(info.position_m).all()
    floor = np.log(ShapeParams().floor)
    np.testing.assert_allclose(info.log_likelihood[:, 7:27], floor, atol=1e-9)
    assert (info.log_likelihood[:, :7] > floor + 1).mean() > 0.9
    assert info.lost[:, 7:27].all()
    assert not info.lost[:, :7].all(1).any()
    assert np.median(errors(info, places)[:, -1]) < 0.5


def test_a_cloud_without_a_time_is_none():
    scans, places = clouds(3)
    time_s = np.where(np.arange(T) == 6, np.nan, scans.time_s)
    _, _, got = run(jax.random.key(0), scans._replace(time_s=time_s), places)
    holes = scans._replace(valid=np.arange(T) != 6)
    _, _, want = run(jax.random.key(0), holes, places)
    np.testing.assert_array_equal(got.position_m, want.position_m)


def test_without_a_template_the_target_is_lost_from_the_first_look():
    scans, places = clouds(3)
    scans = scans._replace(mask=scans.mask & (np.arange(T) > 2)[:, None])
    _, _, info = run(jax.random.key(0), scans, places)
    assert info.lost.all()
    assert jnp.isfinite(info.position_m).all()


def test_padding_and_order_of_points_change_nothing():
    scans, places = clouds(4)
    _, _, want = run(jax.random.key(0), scans, places)
    order = np.random.default_rng(0).permutation(P)
    shuffled = scans._replace(position_m=scans.position_m[:, order], weight=scans.weight[:, order])
    pad = lambda x, value: np.concatenate([x, np.full((T, 7, *x.shape[2:]), value, x.dtype)], 1)
    padded = scans._replace(
        position_m=pad(scans.position_m, np.nan),
        weight=pad(scans.weight, np.nan),
        mask=pad(scans.mask, False),
    )
    for same in (shuffled, padded):
        _, _, got = run(jax.random.key(0), same, places)
        np.testing.assert_allclose(got.position_m, want.position_m, atol=1e-8)


def test_a_look_that_is_none_is_time_that_passes():
    scans, places = clouds(5)
    holes = scans._replace(valid=(np.arange(T) < 3) | (np.arange(T) % 2 == 0))
    _, _, info = run(jax.random.key(0), holes, places)
    there = np.flatnonzero(holes.valid[3:])
    kept = jax.tree.map(lambda x: x[np.r_[:3, 3 + there]], scans)
    _, _, want = run(jax.random.key(0), kept, places[np.r_[:3, 3 + there]])
    np.testing.assert_array_equal(info.position_m[there], want.position_m)
    assert errors(info, places)[there].max() < 0.5


@pytest.mark.parametrize("points", [0, 1, 2])
def test_few_points_give_no_nan(points):
    scans, places = clouds(6)
    few = scans._replace(mask=scans.mask & (np.arange(P) < points)[None])
    template, _, info = run(jax.random.key(0), few, places)
    for leaf in jax.tree.leaves((template, info)):
        assert np.isfinite(np.asarray(leaf, complex)).all()


def test_single_precision_and_one_trace():
    scans, places = clouds(7, dtype=np.float32)
    traces = run._cache_size()
    _, _, info = run(jax.random.key(0), scans, places)
    run(jax.random.key(1), scans, places)
    assert run._cache_size() == traces + 1
    assert info.position_m.dtype == jnp.float32
    assert np.median(errors(info, places)) < 0.2


def test_wrong_values_and_shapes_are_named():
    scans, places = clouds()
    first = jax.tree.map(lambda x: x[:3], scans)
    template = shape_template(first, places[:3])
    with pytest.raises(ValueError, match="places_m"):
        shape_template(first, places[:2])
    with pytest.raises(ValueError, match=r"params\.sigma"):
        shape_tracker(template, ShapeParams(sigma=-1.0))
    with pytest.raises(ValueError, match=r"template\.moments"):
        shape_tracker(template._replace(moments=jnp.zeros(3, complex)))
