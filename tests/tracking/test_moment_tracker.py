import functools

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from jaxtrack.tracking import MomentParams, moment_template, moment_tracker
from jaxtrack.tracking.moment_match import (
    aligned,
    angle_log_likelihood,
    first_threshold,
    similarity_angle,
)
from jaxtrack.types import Scan
from tests.metrics.differences import assert_gradients_agree
from tests.oracles import moment_tracker as oracle

T, P = 16, 48
SETS = [
    ("zernike", "particle"),
    ("zernike", "centroid"),
    ("low_zernike", "particle"),
    ("hu", "particle"),
]


def clouds(seed=0, speed=0.15, looks=T, dtype=float):
    """Return an arc of 30 points that moves along x, and 18 far off, [T, P]."""
    rng = np.random.default_rng(seed)
    turn = rng.uniform(-0.2, 2.2, 30)
    arc = np.stack([0.45 * np.cos(turn), 0.3 * np.sin(turn)], -1) + 0.03 * rng.normal(size=(30, 2))
    places = np.stack([4 + speed * np.arange(looks), 3 + 0 * np.arange(looks)], -1)
    own = places[:, None] + arc[None] + 0.01 * rng.normal(size=(looks, 30, 2))
    others = rng.uniform(10, 20, (looks, P - 30, 2))
    at = np.concatenate([own, others], 1).astype(dtype)
    weight = rng.uniform(0.5, 1.5, (looks, P)).astype(dtype)
    ones = np.ones((looks, P), bool)
    time_s = 6 * np.arange(looks).astype(dtype)
    return Scan(time_s, np.ones(looks, bool), at, ones, weight=weight), places.astype(dtype)


@functools.partial(jax.jit, static_argnames=("features", "origin", "optimised", "particles"))
def run(key, scans, places, features="zernike", origin="particle", optimised=True, particles=60):
    first = jax.tree.map(lambda x: x[:3], scans)
    template = moment_template(first, places[:3], features=features, origin=origin)
    tracker = moment_tracker(
        template,
        places[1:3],
        features=features,
        origin=origin,
        optimised=optimised,
        particles=particles,
    )
    later = jax.tree.map(lambda x: x[3:], scans)
    state, info = jax.lax.scan(tracker.step, tracker.init(key), later)
    return template, state, info


@pytest.mark.parametrize(("features", "origin"), SETS)
def test_template_angles_thresholds_and_weights_are_the_oracles(features, origin):
    scans, places = clouds()
    template, state, info = run(jax.random.key(3), scans, places, features, origin)
    each = [
        oracle.features(scans.position_m[k], scans.weight[k], places[k], features, origin, 1.0)
        for k in range(3)
    ]
    np.testing.assert_allclose(template, np.mean(each, 0), rtol=1e-9)
    limit = None
    for k in range(3, T):
        x = np.asarray(info.particles[k - 3])
        found = [
            oracle.features(scans.position_m[k], scans.weight[k], at, features, origin, 1.0)
            for at in x
        ]
        angles = [None if f is None else oracle.angle(f, template) for f in found]
        ours = np.asarray(info.angle_rad[k - 3])
        want = np.array([np.pi if a is None else a for a in angles])
        np.testing.assert_allclose(ours, want, atol=1e-7)  # of arccos near 1
        limit = oracle.threshold(angles) if limit is None else limit
        # Before the step all weights are equal, unless nothing was resampled.
        if k == 3:
            equal = [1 / len(x)] * len(x)
            weights, lost = oracle.weigh(equal, angles, limit, 0.3)
            np.testing.assert_allclose(info.weight[0], weights, atol=1e-6)
            assert bool(info.lost[0]) == lost
        weight = np.asarray(info.weight[k - 3])
        np.testing.assert_allclose(info.position_m[k - 3], weight @ x, rtol=1e-12)
    np.testing.assert_allclose(state.threshold_rad, limit, atol=1e-7)
    assert {a is None for a in angles} == {False, True} or features == "hu"


def test_steps_turn_as_the_oracle_says():
    rng = np.random.default_rng(1)
    draw, apart = rng.normal(size=(300, 2)), rng.normal(size=(300, 2))
    ours = jax.jit(jax.vmap(aligned))(draw, apart)
    want = [oracle.turned(*both) for both in zip(draw, apart, strict=True)]
    np.testing.assert_allclose(ours, want, rtol=0)


def test_the_small_steps_meet_their_oracles():
    rng = np.random.default_rng(2)
    for _ in range(50):
        a, b = rng.uniform(0.1, 5, (2, 7))
        np.testing.assert_allclose(similarity_angle(a, b), oracle.angle(a, b), atol=1e-7)
        angle, there = rng.uniform(0, 1, 9), rng.random(9) < 0.7
        if there.any():
            some = [x if y else None for x, y in zip(angle, there, strict=True)]
            assert first_threshold(angle, there) == oracle.threshold(some)
    assert similarity_angle(jnp.zeros(7), jnp.zeros(7)) == np.pi / 2
    slope = jax.jit(jax.grad(similarity_angle))
    for a, b in ((np.zeros(7), np.zeros(7)), (np.zeros(7), np.ones(7)), (np.ones(7), np.ones(7))):
        assert jnp.isfinite(slope(a, b)).all()
    assert_gradients_agree(
        jax.jit(lambda a: similarity_angle(a, jnp.arange(1.0, 8.0))), jnp.asarray(rng.random(7))
    )
    gone = angle_log_likelihood(jnp.array([0.2, 0.3]), jnp.array(0.0), 0.3)
    assert jnp.isneginf(gone).all()


@pytest.mark.slow
@pytest.mark.parametrize("optimised", [False, True])
@pytest.mark.parametrize(("features", "origin"), SETS)
def test_it_follows_an_arc(features, origin, optimised):
    scans, places = clouds(1)
    many = jax.random.split(jax.random.key(0), 16)
    one = functools.partial(run, features=features, origin=origin, optimised=optimised)
    _, _, info = jax.vmap(lambda key: one(key, scans, places))(many)
    error = jnp.linalg.norm(info.position_m - places[None, 3:], axis=-1)
    assert jnp.median(error) < 0.45
    assert not info.overflow.any()


def test_lost_targets_are_flagged_and_found_again():
    scans, places = clouds(2, speed=0.02, looks=40)
    gone = (np.arange(40) >= 10) & (np.arange(40) < 30)
    scans = scans._replace(mask=scans.mask & ~gone[:, None])
    many = jax.random.split(jax.random.key(1), 16)
    _, _, info = jax.vmap(lambda key: run(key, scans, places, "low_zernike", particles=120))(many)
    assert jnp.isfinite(info.position_m).all()
    assert info.lost[:, 7:27].all()
    error = jnp.linalg.norm(info.position_m[:, -1] - places[-1:], axis=-1)
    assert jnp.median(error) < 0.5


def test_frames_that_show_too_little_are_left_out_of_the_template():
    scans, places = clouds(2)
    first = jax.tree.map(lambda x: x[:3], scans)
    two = jax.tree.map(lambda x: x[:2], scans)
    want = moment_template(two, places[:2])
    made = jax.jit(moment_template)
    for mask, valid in (
        (first.mask & (np.arange(3) < 2)[:, None], first.valid),
        (first.mask, np.arange(3) < 2),
        (first.mask & ((np.arange(3) < 2)[:, None] | (np.arange(P) < 2)), first.valid),
    ):
        got = made(first._replace(mask=mask, valid=valid), places[:3])
        np.testing.assert_allclose(got, want, rtol=1e-12)


def test_without_a_template_the_target_is_lost_from_the_first_look():
    scans, places = clouds(2)
    scans = scans._replace(mask=scans.mask & (np.arange(T) > 2)[:, None])
    template, _, info = run(jax.random.key(0), scans, places)
    assert not template.any()
    assert info.lost.all()
    assert jnp.isfinite(info.position_m).all()


def test_what_cannot_be_is_refused():
    good = jnp.zeros((2, 2))
    for arguments, word in (
        ((jnp.zeros(5), good), "template: got shape"),
        ((jnp.zeros(7), good, MomentParams(radius_m=0.0)), "params.radius_m"),
        ((jnp.zeros(7), good, MomentParams(sigma=0.0)), "params.sigma"),
        ((jnp.zeros(7), jnp.full((2, 2), jnp.nan)), "places_m"),
    ):
        with pytest.raises(ValueError, match=word):
            moment_tracker(*arguments)


def test_padding_and_order_of_points_change_nothing():
    scans, places = clouds(3)
    _, _, want = run(jax.random.key(0), scans, places)
    order = np.random.default_rng(0).permutation(P)
    shuffled = scans._replace(position_m=scans.position_m[:, order], weight=scans.weight[:, order])
    _, _, got = run(jax.random.key(0), shuffled, places)
    np.testing.assert_allclose(got.position_m, want.position_m, atol=1e-8)
    pad = lambda x, value: np.concatenate([x, np.full((T, 7, *x.shape[2:]), value, x.dtype)], 1)
    padded = scans._replace(
        position_m=pad(scans.position_m, np.nan),
        weight=pad(scans.weight, np.nan),
        mask=pad(scans.mask, False),
    )
    _, _, got = run(jax.random.key(0), padded, places)
    np.testing.assert_allclose(got.position_m, want.position_m, atol=1e-8)


def test_no_look_changes_nothing():
    scans, places = clouds(4)
    holes = scans._replace(valid=(np.arange(T) < 3) | (np.arange(T) % 2 == 0))
    _, _, info = run(jax.random.key(0), holes, places)
    there = np.flatnonzero(holes.valid[3:])
    for k in range(1, T - 3):
        if k not in there:
            np.testing.assert_array_equal(info.position_m[k], info.position_m[k - 1])
    kept = jax.tree.map(lambda x: x[np.r_[:3, 3 + there]], scans)
    _, _, want = run(jax.random.key(0), kept, places[np.r_[:3, 3 + there]])
    np.testing.assert_array_equal(info.position_m[there], want.position_m)


@pytest.mark.parametrize("points", [0, 1, 2, 3])
def test_few_points_give_no_nan(points):
    scans, places = clouds(5)
    few = scans._replace(mask=scans.mask & (np.arange(P) < points)[None])
    template, _, info = run(jax.random.key(0), few, places, "low_zernike")
    assert jnp.isfinite(template).all()
    for leaf in jax.tree.leaves(info):
        assert np.isfinite(np.asarray(leaf, float)).all()
    assert bool(info.lost.all()) == (points < 3)


def test_single_precision():
    scans, places = clouds(6, dtype=np.float32)
    _, _, info = run(jax.random.key(0), scans, places, "low_zernike")
    assert info.position_m.dtype == jnp.float32
    error = jnp.linalg.norm(info.position_m - places[3:], axis=-1)
    assert jnp.median(error) < 0.45


def test_wrong_words_and_shapes_are_named():
    with pytest.raises(ValueError, match="features: got 'legendre'"):
        moment_tracker(jnp.zeros(7), jnp.zeros((2, 2)), features="legendre")
    with pytest.raises(ValueError, match="places_m"):
        moment_tracker(jnp.zeros(7), jnp.zeros((3, 2)))
    with pytest.raises(ValueError, match=r"params\.sigma"):
        moment_tracker(jnp.zeros(7), jnp.zeros((2, 2)), MomentParams(sigma=-1.0))
    scans, places = clouds()
    first = jax.tree.map(lambda x: x[:3], scans)
    with pytest.raises(ValueError, match="origin: got 'corner'"):
        moment_template(first, places[:3], origin="corner")
