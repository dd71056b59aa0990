"""Whole estimators as functions of looks and of their own numbers, for tests of gradients.

A new estimator joins by a line in `CASES`. Looks are drawn around straight targets, in units in
which a detection's noise is one.
"""

import functools
from collections.abc import Callable
from typing import Any, NamedTuple
from unittest import mock

import jax
import jax.numpy as jnp
import numpy as np

from jaxtrack import hough, tracking
from jaxtrack.association import ASSOCIATORS, Associator, cloud, sinkhorn, update_mixture
from jaxtrack.clustering import IsodataSizes
from jaxtrack.filtering import particle, resampling, transport, unscented
from jaxtrack.hough import clustering_statistic, slope_intercept
from jaxtrack.hough.joint import JointParams, JointSizes
from jaxtrack.hough.neutrosophic import NeutrosophicParams, Rules
from jaxtrack.models import (
    BEAMS,
    BeamSensor,
    BeamSonar,
    PolarScan,
    PositionSensor,
    coordinated_turn,
    position_log_likelihood_ratio,
    straight,
)
from jaxtrack.numerics import safe_arctan2, safe_norm
from jaxtrack.studies.learn import weights_trial
from jaxtrack.tracking import LifecycleParams, Softness
from jaxtrack.types import BeamScan, Lines, Pose, Scan


class Field(NamedTuple):
    """What looks are drawn of. Two targets cross a square within the window."""

    looks: int
    detections: int
    interval_s: float
    size_m: float
    sigma_m: float  # of a detection, and the unit of positions


class Inputs(NamedTuple):
    """What a case is a function of; of many, each has one axis more."""

    position: Any  # [K, N, 2] in units of the field's sigma
    weight: Any  # [K, N] in [0, 1]
    number: Any  # [P] of the estimator: factors of its numbers, and shares in [0, 1]
    time_s: Any  # [K]
    valid: Any  # [K]
    mask: Any  # [K, N]
    seed: Any  # [] int


class Case(NamedTuple):
    """An estimator."""

    estimate: Callable[[Scan, Any, Any], Any]  # of looks, its numbers and a seed
    numbers: tuple[float, ...]  # as they are set by hand, > 0
    field: Field
    shares: tuple[tuple[float, float], ...] = ()  # numbers more, from a least to a greatest
    differs: str = ""  # why its gradient is not that of differences; empty: it is


ANY, BELOW, INSIDE = (0.0, 1.0), (0.0, 1 - 1e-6), (1e-6, 1 - 1e-6)
PAIRS = Field(looks=4, detections=4, interval_s=1.0, size_m=1000.0, sigma_m=10.0)
LONG = Field(looks=8, detections=3, interval_s=1.0, size_m=60.0, sigma_m=1.0)
SLOPES = Field(looks=12, detections=3, interval_s=0.5, size_m=80.0, sigma_m=3.0)
CLOUDS = Field(looks=5, detections=12, interval_s=6.0, size_m=4.0, sigma_m=0.3)
SPEED = hough.SpeedGate(50.0, 420.0)
PEAKS = hough.Peaks(50.0, 0.2, 0.0, 30.0)
GRID = hough.Grid((430.0, 310.0), 700.0)
SIZES = hough.Sizes(lines=2, pairs=24, predecessors=6, candidates=24, rho=40, theta=60)


def improved(scans, n, _):
    speed = hough.SpeedGate(n[2], n[3])
    params = hough.improved.ImprovedParams(GRID, PEAKS, speed)
    return hough.improved.soft_estimate(scans, params, n[0], n[1], sizes=SIZES)[0]


def modified(scans, n, _):
    params = hough.modified.ModifiedParams(GRID, PEAKS)
    return hough.modified.soft_estimate(scans, params, n[0], n[1], sizes=SIZES)[0]


def neutrosophic(rules, scans, n, _):
    params = NeutrosophicParams(
        GRID, PEAKS, SPEED, eps_rho_m=n[0], eps_theta_rad=n[1], sigma_m=n[2], p_false=n[4],
        p_gate=n[5],
    )  # fmt: skip
    return hough.neutrosophic.soft_estimate(scans, params, n[3], sizes=SIZES, rules=rules)[0]


def csht(scans, n, _):
    default = clustering_statistic.ClusteringParams(
        slope_intercept.LineGrid(-12.0, 1.0, -60.0, 10.0),
        slope_intercept.LineGrid(-12.0, 1.0, -60.0, 10.0),
        cell_share=n[2],
        line_share=n[3],
    )
    isodata = default.isodata._replace(merge_exponent=n[1])
    sizes = clustering_statistic.ClusteringSizes(
        slope_intercept.LineSizes(25, 24), cells=24, patterns=4, start=3,
        isodata=IsodataSizes(rounds=3, updates=2),
    )  # fmt: skip
    found, info = clustering_statistic.soft_estimate(
        scans, default._replace(isodata=isodata), n[0], 0.05, sizes=sizes
    )
    return found.mean, found.existence, info.clusters.survival


# One track: what several leave each other is not differentiated.
JOINT = JointSizes(tracks=1, hypotheses=48, candidates=16, starts=4, gap=2)


def peaked(found, info):
    """Return what is found, but where it is a place along a ridge and not a maximum."""
    return jnp.where(info.definite[:, None], found.mean, 0.0), found.log_score, found.existence


def joint(samples, scans, n, _):
    sensor = PositionSensor(n[2], n[1], n[0])
    sizes = JOINT._replace(tracks=2 if samples else 1, samples=samples)
    return peaked(*hough.joint.estimate(scans, JointParams(sensor, SPEED, 3.0), sizes=sizes))


def beams(scans, n, _):
    """Take detections for beams: what counts is how far off they are."""
    still = Pose(jnp.zeros_like(scans.position_m[:, 0]), jnp.zeros_like(scans.time_s))
    native = BeamScan(
        scans.time_s, scans.valid, safe_norm(scans.position_m), scans.mask, still, scans.weight
    )
    sonar = BeamSonar(n[1], n[2], n[0], sector_rad=2.0)
    params = JointParams(BeamSensor(sonar), hough.SpeedGate(0.0, 30.0), -5.0)
    return peaked(*hough.joint.estimate(native, params, sizes=JOINT, observation=BEAMS))


def learned(scans, n, seed):
    """Return the loss of the joint vote with learned weights, on simulated looks."""
    dtype = scans.position_m.dtype
    floating = lambda x: jnp.issubdtype(x.dtype, jnp.floating)
    window = jax.tree.map(
        lambda x: x.astype(dtype) if floating(x) else x,
        weights_trial.simulate(jax.random.key(seed)),
    )
    looks = window.scans._replace(valid=scans.valid, mask=window.scans.mask & scans.mask)
    log_ratio = jnp.where(looks.mask & scans.valid[:, None], 20 * (scans.weight - 0.5), 0.0)
    seen = window._replace(scans=looks)
    with mock.patch.object(weights_trial, "simulate", return_value=seen):
        loss = weights_trial.track_loss(lambda given, _: given)
        return loss({"network": log_ratio, "gate": n[0]}, jax.random.key(0))


def tracked(associator, of, scans, n, _, polar=False):
    """Return existences and places of the Kalman tracker with soft lives."""
    lives = LifecycleParams(2, n[4], 2, 2)
    params = tracking.KalmanTrackerParams(
        n[0], n[1], n[8], 1e-3 * n[7], n[2], gate=n[3], lifecycle=lives
    )
    softness = Softness(looks=0.25 * n[5], score=n[6], gate=n[6])
    tracker = tracking.kalman_tracker(
        params, max_tracks=3, associator=associator, confirm_looks=4, filter=of(n),
        lives=tracking.soft_lives(softness),
    )  # fmt: skip
    if polar:
        still = Pose(jnp.zeros_like(scans.position_m[:, 0]), jnp.zeros_like(scans.time_s))
        bearing = safe_arctan2(scans.position_m[..., 1], scans.position_m[..., 0])
        scans = PolarScan(
            scans.time_s, scans.valid, safe_norm(scans.position_m), bearing, scans.mask, still
        )
    _, info = jax.lax.scan(tracker.step, tracker.init(jax.random.key(0)), scans)
    return info.tracks.existence, info.tracks.log_score, info.tracks.mean[..., :4]


def turning(n):
    return coordinated_turn(n[1], 0.05 * n[1])


def two_motions(n):
    chance, switching = jnp.array([0.7, 0.3]), jnp.array([[0.9, 0.1], [0.2, 0.8]])
    of = [straight(n[1], 0.2 * n[1]), turning(n)]
    cast = lambda x: x.astype(n.dtype)
    rest = n[2], n[2], 0.1 * n[2]
    return tracking.interacting_filter(of, cast(chance), cast(switching), n[0], rest)


def polar(n):
    return tracking.range_bearing_filter(
        turning(n), n[0], 0.02 * n[0], (n[2], n[2], 0.1 * n[2]), linearize=unscented.linearize
    )


def initiated(scans, n, _):
    """Return tracks along two lines through the field."""
    dtype = scans.position_m.dtype
    lines = Lines(jnp.asarray([500.0, 450.0], dtype), jnp.asarray([0.1, 1.5], dtype),
                  jnp.ones(2, dtype), jnp.ones(2, bool))  # fmt: skip
    params = tracking.InitiateParams(400.0, 400.0, n[0], SPEED, 0.8 + 0.2 * n[1], 2)
    found, info = tracking.initiate(scans, lines, params, nearest=3)
    return found.mean, info.smoothed_m


def particles(resampler, scans, n, seed):
    """Return the log-likelihood and the means of particles that are seen as positions."""
    dtype = scans.position_m.dtype
    sensor = PositionSensor(n[3], n[2], n[0])

    def move(key, x, scan):
        noise = n[1] * jax.random.normal(key, x.shape, dtype)
        return jnp.concatenate([x[:, :2] + x[:, 2:] + noise[:, :2], x[:, 2:] + noise[:, 2:]], 1)

    def told(x, scan):
        return jax.vmap(lambda one: position_log_likelihood_ratio(one, scan, sensor))(x)

    of = particle.particle_filter(
        move, told, resampler, particles=12, resample_below=0.9,
        initial=lambda key, size: 20 + 10 * jax.random.normal(key, (size, 4), dtype),
    )  # fmt: skip
    state, info = jax.lax.scan(of.step, of.init(jax.random.key(seed)), scans)
    return state.log_likelihood, info.mean, info.effective_size


def shape(scans, n, seed):
    """Return what a template's particles find in the later clouds."""
    first, later = (jax.tree.map(lambda x, at=at: x[at], scans) for at in (slice(2), slice(2, 5)))
    params = tracking.ShapeParams(n[0], n[4], spread_m=n[1], shake_m=n[1], sigma=n[2],
                                  mass_sigma=n[3], floor=n[5])  # fmt: skip
    places = jnp.asarray([[1.6, 1.6], [1.8, 1.8]], scans.position_m.dtype)
    first = first._replace(valid=jnp.ones(2, bool))
    template = tracking.shape_template(first, places, params)
    tracker = tracking.shape_tracker(template, params, particles=8, most=12)
    info = jax.lax.scan(tracker.step, tracker.init(jax.random.key(seed)), later)[1]
    return info.position_m, info.log_likelihood


PLAIN = lambda n: tracking.straight_filter(n[0], n[1], n[2])


def kalman(associator, of, **more):
    numbers = 1.0, 0.3, 4.0, 9.21, 3.0, 1.0, 1.0, 1.0
    return Case(functools.partial(tracked, associator, of, **more), numbers, LONG, (ANY,))


SHARED = Associator(sinkhorn.associate, update_mixture)
SOFT_CLOUD = ASSOCIATORS["cloud_soft"]._replace(
    associate=functools.partial(cloud.soft, iterations=3)
)
CHOICE = "which trajectories are looked at is a choice, and where the samples stand is fixed"
CASES = {
    "modified": Case(modified, (20.0, 0.1), PAIRS),
    "improved": Case(improved, (20.0, 0.1, 50.0, 420.0), PAIRS),
    **{
        f"neutrosophic, {rules.landing}, {rules.scale}": Case(
            functools.partial(neutrosophic, rules), (20.0, 0.15, 10.0, 0.3), PAIRS, (ANY, BELOW)
        )
        for rules in (Rules("own_cell"), Rules("spread"), Rules("spread", "covariance"))
    },
    "clustering statistic": Case(csht, (3.0, 2.0), SLOPES, (BELOW, BELOW)),
    "joint": Case(functools.partial(joint, 0), (10.0, 4e-6), PAIRS, (ANY,)),
    "joint, samples": Case(functools.partial(joint, 32), (10.0, 4e-6), PAIRS, (ANY,), CHOICE),
    "joint, beams": Case(beams, (2.0,), LONG._replace(detections=8, looks=5), (ANY, ANY)),
    "learned": Case(
        learned,
        (10.0,),
        Field(weights_trial.LOOKS, weights_trial.BEAM_COUNT, 0.5, 80.0, 3.0),
        differs=CHOICE,
    ),
    "initiate": Case(initiated, (10.0,), PAIRS, (ANY,)),
    **{
        f"tracker, {name}": kalman(associator, PLAIN)
        for name, associator in (
            *((name, ASSOCIATORS[name]) for name in ("pda", "jpda", "pmht", "belief_propagation")),
            ("scaling", SHARED),
            ("cloud_soft", SOFT_CLOUD),
        )
    },
    "tracker, two motions": kalman("jpda", two_motions),
    "tracker, polar": kalman("jpda", polar, polar=True),
    "particles, soft": Case(
        functools.partial(particles, resampling.soft()), (1.0, 1.0, 1e-3), LONG, (ANY,)
    ),
    "particles, transport": Case(
        functools.partial(particles, transport.optimal_transport(0.5, iterations=10)),
        (1.0, 1.0, 1e-3), LONG, (ANY,),
    ),
    "particles": Case(
        functools.partial(particles, None), (1.0, 1.0, 1e-3), LONG, (ANY,),
        "weights carry the gradient of the draw, which no difference shows",
    ),
    "shape": Case(shape, (1.0, 0.1, 0.4, 1.0), CLOUDS, (INSIDE, INSIDE)),
}  # fmt: skip


def loss(name, position, weight, number, rest):
    """Return all that an estimator gives in one number; the order of tracks has no say."""
    case = CASES[name]
    dtype = position.dtype
    # What does not count holds NaN.
    there = rest.mask & rest.valid[:, None]
    place = jnp.where(there[..., None], position * case.field.sigma_m, jnp.nan)
    scans = Scan(
        rest.time_s, rest.valid, place, rest.mask, weight=jnp.where(there, weight, jnp.nan)
    )
    scale = jnp.asarray(case.numbers + (1.0,) * len(case.shares), dtype)
    found = case.estimate(scans, number * scale, rest.seed)
    floating = [x for x in jax.tree.leaves(found) if jnp.issubdtype(x.dtype, jnp.floating)]
    return sum(0.8**n * jnp.arcsinh(x).sum() for n, x in enumerate(floating))


def draw(name, rng, count):
    """Return the inputs of many realizations, all plain."""
    case = CASES[name]
    field, shape = case.field, (count, case.field.looks, case.field.detections)
    time_s = np.cumsum(field.interval_s * rng.uniform(0.9, 1.1, shape[:2]), axis=1)
    size = field.size_m / field.sigma_m
    position = rng.uniform(0.0, size, (*shape, 2))
    ends = rng.uniform(0.0, size, (2, count, 2, 2))
    share = ((time_s - time_s[:, :1]) / np.ptp(time_s, axis=1, keepdims=True))[..., None, None]
    path = ends[0][:, None] * (1 - share) + ends[1][:, None] * share
    seen = rng.random((*shape[:2], 2)) < 0.9
    noisy = path + rng.normal(size=path.shape)
    position[:, :, :2] = np.where(seen[..., None], noisy, position[:, :, :2])
    number = [rng.uniform(0.8, 1.25, (count, len(case.numbers)))]
    number.append(rng.uniform(0.2, 0.8, (count, len(case.shares))))
    return Inputs(
        position,
        rng.uniform(0.4, 1.0, shape),
        np.concatenate(number, axis=1),
        time_s,
        rng.random(shape[:2]) < 0.95,
        rng.random(shape) < 0.85,
        np.arange(count, dtype=np.int32),
    )


def degenerate(name, rng, inputs, most):
    """Put something special into every realization: `most` and its inverse are huge and tiny."""
    case = CASES[name]
    count = len(inputs.seed)
    one_of = lambda *choices: np.choose(
        rng.integers(0, len(choices), count).reshape(-1, *(1,) * (choices[0].ndim - 1)),
        [np.broadcast_to(x, choices[0].shape) for x in choices],
    )
    p, w, n = inputs.position, inputs.weight, inputs.number
    alike = p[:, :1, :1]
    position = one_of(
        p, p, alike, p[:, :, :1], p[:, :1], 0 * p, most * p, p / most, np.round(p / 9), p * [1, 0],
        p + most,
    )  # fmt: skip
    weight = one_of(w, w, 0 * w, 0 * w + 1, w / most, np.round(w))
    factors = most ** rng.uniform(-1, 1, n.shape)
    extremes = np.exp2(np.sign(factors - 1) * np.log2(most))
    shares = np.arange(n.shape[1]) >= len(case.numbers)
    bounds = np.array([ANY] * len(case.numbers) + list(case.shares))
    edges = np.where(rng.random(n.shape) < 0.5, *bounds.T)
    near = np.where(edges < 0.5, 1e-6, 1 - 1e-6)
    number = one_of(
        n,
        n,
        np.where(shares, near, n * factors),
        np.where(shares, edges, n * extremes),
        np.where(rng.random(n.shape) < 0.2, np.where(shares, edges, n * extremes), n),
    )
    t = inputs.time_s
    time_s = one_of(t, t, t, 0 * t, most * t, t / most)
    v = inputs.valid
    first = np.arange(v.shape[1])[None] < rng.integers(0, 3, (count, 1))
    valid = one_of(v, v, v, v & False, v | True, rng.random(v.shape) < 0.5, first)
    m = inputs.mask
    single = rng.random(m.shape) < 1.5 / m[0].size
    mask = one_of(m, m, m, m & False, m | True, single, m & (rng.random((*v.shape, 1)) < 0.3))
    return Inputs(position, weight, number, time_s, valid, mask, inputs.seed)
