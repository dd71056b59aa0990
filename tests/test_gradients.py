"""Gradients of the public differentiable functions, all asked the same.

Compiled ones equal central differences where all is smooth, are finite on ten thousand random and
degenerate inputs, and in single precision are those of double to a hundredth. A new function joins
by a line in `CASES`. What is an estimator has tests of its own beside it, and so have functions
whose gradient is by intent that of something else (resampling, the floors, image moments).

An input's kind says where it may lie: "real", "positive", "share" in (0, 1), or "root", a matrix A
that stands for the positive semidefinite A Aᵀ.
"""

import functools

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from jaxtrack import (
    association,
    clustering,
    filtering,
    hough,
    metrics,
    models,
    moments,
    numerics,
    sensors,
    tuning,
)
from jaxtrack.association import belief_propagation, cloud, jpda, pda, pmht
from jaxtrack.clustering.cloud import cloud_cmeans
from jaxtrack.filtering import (
    extended,
    gaussian,
    interacting,
    kalman,
    particle,
    resampling,
    smoother,
    unscented,
)
from jaxtrack.hough import slope_intercept, standard
from jaxtrack.hough.votes import Votes, evaluate, scaled_gaussian, soft
from jaxtrack.hough.votes import gaussian as gaussian_votes
from jaxtrack.types import Lines, Pose, Scan
from tests.metrics.differences import assert_gradients_agree

FULL2, FULL3, FULL4 = (np.ones(n, bool) for n in (2, 3, 4))
PARTLY = np.array([True, False, True, True])
GRID, SIZES = hough.Grid((0.0, 0.0), 20.0), hough.Sizes(rho=20, theta=12)
LINE_GRID = slope_intercept.LineGrid(-2.0, 2.0, -8.0, 4.0)
LINE_SIZES = slope_intercept.LineSizes(velocities=4, positions=8, fine=8)


def square(root):
    """Return a covariance of a root; of a zero one as well."""
    return root @ jnp.swapaxes(root, -1, -2)


def definite(root):
    """Return a covariance that has an inverse, whatever the root."""
    unit = jnp.eye(root.shape[-1], dtype=root.dtype)
    return square(root) + 0.1 * jnp.broadcast_to(unit, root.shape)


def hidden(x, mask):
    return jnp.where(mask.reshape(mask.shape + (1,) * (x.ndim - mask.ndim)), x, jnp.nan)


def scan(places, weight=None):
    """Return one look of four detections, NaN behind one's mask."""
    there = jnp.asarray(PARTLY)
    dtype = places.dtype
    return Scan(
        jnp.zeros((), dtype), jnp.asarray(True), hidden(places, there), there, weight=weight
    )


def predicted(mean, roots):
    covariance = square(roots)
    noise = 0.5 * jnp.eye(2, dtype=mean.dtype)
    return association.predict_measurement(mean, covariance, noise), covariance


def associated(associate, mean, roots, places, weight, p_detect, clutter):
    known = association.AssociationParams(p_detect, clutter, 1e4)
    found = associate(predicted(mean, roots)[0], scan(places, weight), known, jax.random.key(0))
    return found.weight, found.miss


def updated(update, mean, roots, places, share):
    at, covariance = predicted(mean, roots)
    there = jnp.asarray(PARTLY)
    weight = jnp.where(there[None, :], share, 0.0) / 4
    found = association.Association(weight, 1 - weight.sum(1), jnp.asarray(True))
    return update(mean, covariance, at, scan(places), found)


def kernel(of, rho, theta, weight, eps):
    there = jnp.asarray(PARTLY)
    votes = Votes(hidden(rho, there), hidden(theta, there), hidden(weight, there), there)
    at = jnp.asarray([1.0, -2.0], rho.dtype), jnp.asarray([0.4, 2.0], rho.dtype)
    return evaluate(*at, votes, of(eps, rho.dtype))


def looks(places, weight):
    """Return three looks of two detections."""
    shape = places.shape[:2]
    time_s = jnp.arange(shape[0], dtype=places.dtype)
    return Scan(time_s, jnp.ones(shape[0], bool), places, jnp.ones(shape, bool), weight=weight)


def settled(samples, weights, centres):
    found = clustering.fuzzy_cmeans(samples, weights, centres, iterations=30)
    return found.objective


def clouds(samples, weights, floor):
    start = -((samples[None] - samples[:2, None]) ** 2).sum(-1)
    found = cloud_cmeans(
        samples, weights, start, centres=samples[:2], floor=floor, temperature=0.5, iterations=3
    )
    return found.cloud.expectation, found.objective


def smoothed(mean, roots, noise_root):
    step = jnp.broadcast_to(models.transition_matrix(jnp.ones((), mean.dtype)), (3, 4, 4))
    noise = jnp.broadcast_to(definite(noise_root), (3, 4, 4))
    filtered = gaussian.Moments(mean, definite(roots))
    ahead = jax.vmap(gaussian.predict)(*filtered, step, noise)
    shift = lambda x, first: jnp.concatenate([first[:1], x[:-1]])
    before = gaussian.Moments(*(shift(x, y) for x, y in zip(ahead, filtered, strict=True)))
    return smoother.smooth(filtered, before, step, noise)


def range_bearing(state):
    dtype = state.dtype
    pose = Pose(jnp.asarray([1.0, 2.0], dtype), jnp.asarray(0.3, dtype))
    return models.range_bearing(state, pose)


def entropic(score):
    return lambda x, y, cutoff: (
        score(
            x, FULL3, y, PARTLY, cutoff=cutoff, order=2.0, temperature=0.1, iterations=20
        ).distance
    )


def sets(score, **more):
    return lambda x, y, cutoff: score(x, FULL3, y, PARTLY, cutoff=cutoff, order=1.5, **more)


def tracks(score, **more):
    masks = np.ones((3, 2), bool), np.array([[True, True], [True, False], [True, True]])
    return lambda x, y, cutoff: score(x, masks[0], y, masks[1], cutoff=cutoff, order=1.5, **more)


def meeting(angle, gap, sigma):
    return sensors.meeting_targets(
        jax.random.key(0), sensors.Meeting(angle, gap, sigma), looks=5
    ).state.astype(angle.dtype)


def faded(middle, length, edge):
    places = jnp.zeros((4, 2, 2), middle.dtype)
    origin = np.tile([0, -1], (4, 1))
    return sensors.fade(looks(places, None), origin, sensors.Fade(middle, length, edge)).weight


R, P, S = "real", "positive", "share"
TRACKED = (R, (3, 4)), ("root", (3, 4, 4)), (R, (4, 2))
SAMPLED = (R, (5, 2)), (P, (5,)), (R, (2, 2))
# name: (function, inputs)
CASES = {
    "safe_sqrt": (numerics.safe_sqrt, [(P, (4,))]),
    "safe_log": (numerics.safe_log, [(P, (4,))]),
    "safe_norm": (numerics.safe_norm, [(R, (3, 2))]),
    "safe_sinc": (numerics.safe_sinc, [(R, (4,))]),
    "safe_divide": (numerics.safe_divide, [(R, (4,)), (R, (4,))]),
    "safe_arctan2": (numerics.safe_arctan2, [(R, (4,)), (R, (4,))]),
    "safe_max, safe_min": (lambda x: (numerics.safe_max(x), numerics.safe_min(x)), [(R, (3, 4))]),
    "wrap_angle": (numerics.wrap_angle, [(R, (4,))]),
    "masked_logsumexp": (
        lambda x: numerics.masked_logsumexp(hidden(x, jnp.asarray(PARTLY)), PARTLY),
        [(R, (4,))],
    ),
    "masked_mean, masked_max": (
        lambda x: (numerics.masked_mean(x, PARTLY), numerics.masked_max(x, PARTLY)),
        [(R, (4,))],
    ),
    "definite_inverse": (lambda a: numerics.definite_inverse(definite(a))[0], [("root", (3, 3))]),
    "scaled_inverse": (lambda a: numerics.scaled_inverse(definite(a))[0], [("root", (3, 3))]),
    "bounded": (numerics.bounded(-1.0, 2.0).forward, [(R, (4,))]),
    "positive": (numerics.positive().forward, [(R, (4,))]),
    "simplex": (numerics.simplex().forward, [(R, (4,))]),
    "assign": (lambda x: numerics.assign(x, FULL3, FULL4).cost, [(R, (3, 4))]),
    "line_through": (models.line_through, [(R, (2,)), (R, (2,)), (R, (2,))]),
    "line_difference": (models.line_difference, [(R, (3,))] * 4),
    "line_covariance": (models.line_covariance, [(R, (2,)), (R, (2,)), (R, (2,)), (P, ())]),
    "point_line_distance": (models.point_line_distance, [(R, ()), (R, ()), (R, (2,))]),
    "position_log_likelihood_ratio": (
        lambda state, places, p, clutter, sigma: models.position_log_likelihood_ratio(
            state, scan(places), models.PositionSensor(p, clutter, sigma)
        ),
        [(R, (4,)), (R, (4, 2)), (S, ()), (P, ()), (P, ())],
    ),
    "range_bearing": (range_bearing, [(R, (4,))]),
    "transition_matrix": (models.transition_matrix, [(P, ())]),
    "white_noise_acceleration": (models.white_noise_acceleration, [(P, ()), (P, ())]),
    "turn": (models.turn, [(R, (5,)), (P, ())]),
    "kalman.update": (
        lambda m, a, z, h, n: kalman.update(m, square(a), z, h, definite(n)),
        [(R, (4,)), ("root", (4, 4)), (R, (2,)), (R, (2, 4)), ("root", (2, 2))],
    ),
    "extended.update": (
        lambda m, a, z, n: extended.update(m, square(a), z, range_bearing, definite(n)),
        [(R, (4,)), ("root", (4, 4)), (R, (2,)), ("root", (2, 2))],
    ),
    "unscented.update": (
        lambda m, a, z, n: unscented.update(m, definite(a), z, range_bearing, definite(n)),
        [(R, (4,)), ("root", (4, 4)), (R, (2,)), ("root", (2, 2))],
    ),
    "smooth": (smoothed, [(R, (3, 4)), ("root", (3, 4, 4)), ("root", (4, 4))]),
    "mix": (
        lambda m, a, p, s: interacting.mix(
            m, square(a), p / p.sum(), s / s.sum(1, keepdims=True)
        ),
        [(R, (2, 4)), ("root", (2, 4, 4)), (P, (2,)), (P, (2, 2))],
    ),
    "combine": (
        lambda m, a, p: interacting.combine(m, square(a), p / p.sum()),
        [(R, (2, 4)), ("root", (2, 4, 4)), (P, (2,))],
    ),
    "reweigh": (lambda p, ll: interacting.reweigh(p / p.sum(), ll), [(P, (3,)), (R, (3,))]),
    "normalized": (resampling.normalized, [(R, (5,))]),
    "effective_size": (particle.effective_size, [(R, (5,))]),
    "weighted_mean": (particle.weighted_mean, [(R, (5, 2)), (R, (5,))]),
    "optimal_transport": (
        lambda x, w: filtering.transport.optimal_transport(0.5, iterations=10)(
            jax.random.key(0), x, w
        ).particles,
        [(R, (5, 2)), (R, (5,))],
    ),
    "pda.marginals": (pda.marginals, [(P, (3, 4)), (P, (3,))]),
    "jpda.marginals": (jpda.marginals, [(P, (3, 4)), (P, (3,))]),
    "belief_propagation.marginals": (belief_propagation.marginals, [(P, (3, 4)), (P, (3,))]),
    **{
        name: (functools.partial(associated, method), [*TRACKED, (S, (4,)), (S, ()), (P, ())])
        for name, method in (
            ("pda", pda.associate),
            ("jpda", jpda.associate),
            ("pmht", pmht.associate),
            ("cloud.soft", functools.partial(cloud.soft, iterations=2)),
        )
    },
    **{
        method.__name__: (functools.partial(updated, method), [*TRACKED, (S, (3, 4))])
        for method in (
            association.update_mixture,
            association.update_centroid,
            association.update_single,
        )
    },
    "memberships": (
        lambda x, c, m: clustering.memberships(x, c, active=FULL2, fuzzifier=1.2 + m),
        [(R, (5, 2)), (R, (2, 2)), (P, ())],
    ),
    "update": (
        lambda x, w, c: clustering.update(x, w, c, active=FULL2, fuzzifier=2.0),
        SAMPLED,
    ),
    "fuzzy_cmeans": (settled, SAMPLED),
    "cloud_cmeans": (clouds, [(R, (5, 2)), (P, (5,)), (P, (5, 2))]),
    "hu": (moments.hu, [(R, (5, 2)), (P, (5,))]),
    "soft_zernike": (
        lambda x, w, r: jnp.abs(
            moments.soft_zernike(x, w, orders=((2, 0), (4, 0)), radius=1.0 + r, taper=0.5)
        ) ** 2,
        [(R, (5, 2)), (P, (5,)), (P, ())],
    ),
    "soft_log_features": (
        lambda x, y, eps: moments.soft_log_features(jax.lax.complex(x, y), eps),
        [(R, (4,)), (R, (4,)), (P, ())],
    ),
    "ospa": (sets(metrics.ospa), [(R, (3, 2)), (R, (4, 2)), (P, ())]),
    "gospa": (sets(metrics.gospa), [(R, (3, 2)), (R, (4, 2)), (P, ())]),
    "ospa2": (tracks(metrics.ospa2), [(R, (3, 2, 2)), (R, (3, 2, 2)), (P, ())]),
    "trajectory_gospa": (
        tracks(metrics.trajectory_gospa, switch_cost=0.3),
        [(R, (3, 2, 2)), (R, (3, 2, 2)), (P, ())],
    ),
    "nees": (
        lambda m, a, x: metrics.nees(m, definite(a), x).squared,
        [(R, (4,)), ("root", (4, 4)), (R, (4,))],
    ),
    "line_distance": (
        lambda rho, theta, x: metrics.line_distance(Lines(rho, theta, rho, jnp.asarray(FULL2)), x),
        [(R, (2,)), (R, (2,)), (R, (3, 4, 2))],
    ),
    "least_squares_line": (metrics.least_squares_line, [(R, (4, 2))]),
    "votes soft": (
        functools.partial(kernel, lambda e, dtype: soft(GRID, SIZES, e[0], e[1], dtype)),
        [(R, (4,)), (S, (4,)), (P, (4,)), (P, (2,))],
    ),
    "votes gaussian": (
        functools.partial(kernel, lambda e, dtype: gaussian_votes(e[0], e[1])),
        [(R, (4,)), (S, (4,)), (P, (4,)), (P, (2,))],
    ),
    "votes scaled gaussian": (
        functools.partial(
            kernel,
            lambda e, dtype: scaled_gaussian(
                jnp.broadcast_to(jnp.stack([e[0], 0.0 * e[0], e[1]]), (4, 3)), jnp.asarray(PARTLY)
            ),
        ),
        [(R, (4,)), (S, (4,)), (P, (4,)), (P, (2,))],
    ),
    "standard.soft_votes": (
        lambda x, w, e: standard.soft_votes(
            jnp.asarray([1.0, 3.0], x.dtype), jnp.asarray([0.4, 2.0], x.dtype),
            looks(x, w), GRID, e[0], e[1], sizes=SIZES,
        ),
        [(R, (3, 2, 2)), (S, (3, 2)), (P, (2,))],
    ),
    "slope_intercept.soft_votes": (
        lambda x, w, e: slope_intercept.soft_votes(
            slope_intercept.Points(
                jnp.broadcast_to(jnp.arange(3, dtype=x.dtype)[:, None], (3, 2)), x, w
            ),
            LINE_GRID, e, sizes=LINE_SIZES,
        ),
        [(R, (3, 2)), (S, (3, 2)), (P, ())],
    ),
    "beam_pattern": (sensors.beam_pattern, [(R, (4,)), (P, ())]),
    "meeting_targets": (meeting, [(R, ()), (R, ()), (P, ())]),
    "fade": (faded, [(R, (2,)), (P, (2,)), (P, ())]),
    "candidate_softmax": (
        lambda s, t: tuning.candidate_softmax(
            s, PARTLY, np.eye(4, 2, dtype=bool), temperature=t
        ),
        [(R, (4,)), (P, ())],
    ),
    "sinkhorn_ospa": (entropic(tuning.sinkhorn_ospa), [(R, (3, 2)), (R, (4, 2)), (P, ())]),
    "sinkhorn_gospa": (entropic(tuning.sinkhorn_gospa), [(R, (3, 2)), (R, (4, 2)), (P, ())]),
    "false_track_loss": (
        lambda g, t: tuning.false_track_loss(
            g, jnp.asarray([2.0, 0.3, -0.2, 0.5], g.dtype), PARTLY, false_per_run=0.3, temperature=t
        ),
        [(R, ()), (P, ())],
    ),
}  # fmt: skip
every_case = pytest.mark.parametrize("name", CASES)
# These compile for seconds, and central differences are among their own tests too.
LONG = [
    "extended.update",
    "unscented.update",
    "smooth",
    "mix",
    "pda",
    "jpda",
    "pmht",
    "cloud.soft",
    "cloud_cmeans",
    "fuzzy_cmeans",
    "memberships",
    "update",
    "update_mixture",
    "update_centroid",
    "update_single",
    "hu",
    "soft_zernike",
    "sinkhorn_ospa",
    "sinkhorn_gospa",
    "ospa",
    "gospa",
    "ospa2",
    "trajectory_gospa",
    "optimal_transport",
    "jpda.marginals",
    "belief_propagation.marginals",
    "votes soft",
    "votes scaled gaussian",
    "standard.soft_votes",
    "slope_intercept.soft_votes",
    "kalman.update",
    "position_log_likelihood_ratio",
]


def test_the_long_ones_exist():
    assert set(LONG) < set(CASES)


def loss(name, *inputs):
    """Return all that a function gives in one number of the order of one."""
    leaves = jax.tree.leaves(CASES[name][0](*inputs))
    floating = [leaf for leaf in leaves if jnp.issubdtype(leaf.dtype, jnp.floating)]
    return sum((0.9**n * jnp.sin(leaf)).sum() for n, leaf in enumerate(floating))


def sample(rng, kind, shape, count=()):
    shape = (*count, *shape)
    if kind == "positive":
        return rng.uniform(0.3, 1.5, shape)
    if kind == "share":
        return rng.uniform(0.1, 0.9, shape)
    return rng.normal(size=shape)


def inputs(name, seed, count=()):
    rng = np.random.default_rng(seed)
    return [sample(rng, *one, count) for one in CASES[name][1]]


@functools.cache
def value_and_slopes(name):
    everything = tuple(range(len(CASES[name][1])))
    return jax.jit(jax.value_and_grad(functools.partial(loss, name), argnums=everything))


@pytest.mark.parametrize(
    "name", [pytest.param(n, marks=pytest.mark.slow) if n in LONG else n for n in CASES]
)
def test_jitted_gradients_equal_central_differences(name):
    assert_gradients_agree(functools.partial(loss, name), *inputs(name, 3), rtol=1e-5, atol=1e-7)


@pytest.mark.slow
@every_case
def test_single_precision_is_within_a_hundredth(name):
    at = inputs(name, 3)
    _, expected = value_and_slopes(name)(*at)
    value, got = value_and_slopes(name)(*(np.float32(x) for x in at))
    assert value.dtype == np.float32
    for one, other in zip(got, expected, strict=True):
        assert one.dtype == np.float32
        np.testing.assert_allclose(one, other, rtol=1e-2, atol=1e-2 * np.abs(other).max() + 1e-6)


def degenerate(rng, kind, values, dtype):
    """Put one of several special things into each of many values of an input.

    Single precision is asked for less: fourth powers of 1e4 over squares of 1e-6 are not in it.
    """
    tiny, huge = (1e-6, 1e4) if dtype == np.float64 else (1e-3, 1e2)
    least = 0.0 if kind in ("real", "root") else tiny
    choices = [
        values,
        np.full_like(values, least),
        np.broadcast_to(values[:, :1], values.shape) if values.ndim > 1 else values,
        np.full_like(values, 1 - tiny) if kind == "share" else huge * values,
        tiny * values,
        np.round(values),
    ]
    which = rng.integers(0, len(choices), len(values)).reshape(-1, *(1,) * (values.ndim - 1))
    found = np.choose(np.broadcast_to(which, values.shape), choices)
    return np.maximum(found, least) if least else found


@pytest.mark.slow
@every_case
@pytest.mark.parametrize("dtype", [np.float64, np.float32])
def test_gradients_are_finite_on_ten_thousand_inputs(name, dtype):
    rng = np.random.default_rng(11)
    many = inputs(name, 5, (10_000,))
    special = [
        degenerate(rng, kind, x, dtype) for (kind, _), x in zip(CASES[name][1], many, strict=True)
    ]
    plain = np.arange(10_000) < 3_000
    at = [np.where(plain.reshape(-1, *(1,) * (x.ndim - 1)), x, y).astype(dtype)
          for x, y in zip(many, special, strict=True)]  # fmt: skip
    value, slopes = jax.jit(jax.vmap(value_and_slopes(name)))(*at)
    assert np.isfinite(value).all()
    for place, slope in enumerate(slopes):
        bad = ~np.isfinite(slope).reshape(len(value), -1).all(1)
        first = [x[bad.argmax()] for x in at] if bad.any() else None
        assert not bad.any(), f"input {place}, {bad.sum()} times, first at {first}"
