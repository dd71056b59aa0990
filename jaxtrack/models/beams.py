"""What one look of a multi-beam sonar says about a target in a given state.

A target at range ρ and bearing α (u in beams from the port edge) stands in beam b with probability
P(b | u), the mass of N(u, s_b²) on the beam. A beam that holds it and reports range r, or nothing,
is by

    Λ_b = {(1 − o) [(1 − P_M) N(r; ρ, σ²) + P_M c P_F / ρ_D] + o / ρ_D} / (P_F / ρ_D),
    Λ_b = (1 − o) P_M (1 − c P_F) / (1 − P_F)

likelier than one that is empty, and the look's log-likelihood ratio is log Σ_b P(b | u) Λ_b over
the three nearest beams: three gathers, however many beams there are. o is the probability that
another target answers in the beam instead.
Outside the sector and the scope nothing can be seen, Λ = 1.
"""

import math
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from jaxtrack.models.frames import polar_to_earth
from jaxtrack.models.motion import look_times
from jaxtrack.models.observation import Observation
from jaxtrack.models.sonar import BeamSonar, beam_bearings, check_sonar
from jaxtrack.numerics.checks import check_beam_scans, check_positive, check_probability
from jaxtrack.numerics.definite import scaled_inverse
from jaxtrack.numerics.safe import safe_divide, safe_sqrt
from jaxtrack.types import Array, BeamScan, Pose, Scan

_LEAST = 1e-6  # share of everything that the model does not know: bounds a look's penalty
_PAD = 3  # beams that do not exist, on each side


class BeamSensor(NamedTuple):
    """What a multi-beam sonar's likelihood needs. Traced."""

    sonar: BeamSonar = BeamSonar()
    spread_beams: Array | float = 0.1  # s_b, blur of the beams' edges
    p_other: Array | float = 0.02  # o, a beam with the target reports another target instead


_Three = tuple[Array, Array, Array]
"""One array for each of the nearest beams: stacked, the compiler would not vectorize them."""


class _Report(NamedTuple):
    """What the three nearest beams report to each state."""

    range_m: _Three
    peak: _Three  # of the target's own detection: w (1 − o) (1 − P_M) ρ_D / (P_F σ √2π)
    rest: _Three  # ratio of everything else that the report can be; 1 where there is no beam


class _Place(NamedTuple):
    """Where states are in the sonar's frame, […]."""

    range_m: Array
    beams: Array  # from the port edge of the sector
    ahead_m: Array
    starboard_m: Array


def beam_log_likelihood_ratio(state: Array, scan: BeamScan, params: BeamSensor) -> Array:
    """Return log p(look | target at state) − log p(look | no target), in nats.

        log[ Q (Σ_b P(b | u) Λ_b) + 1 − Q ],   Q = Φ((ρ_D − ρ)/σ)

    Args:
        state: [4] x, y, vx, vy at the look's time.
        scan: one look; a detection of weight w counts with probability w, and says nothing else.
        params: the sonar and the blur of its beams' edges.

    Returns:
        A scalar; 0 for an invalid look and outside sector and scope.

    Example:
        >>> from jaxtrack.types import Pose
        >>> scan = BeamScan(jnp.array(0.0), jnp.array(True), jnp.full(9, 50.0),
        ...                 jnp.arange(9) == 4, Pose(jnp.zeros(2), jnp.array(0.0)))
        >>> state = jnp.array([50.0, 0.0, 0.0, 0.0])
        >>> print(f"{beam_log_likelihood_ratio(state, scan, BeamSensor()):.2f}")
        3.82

    Source: the statistic of maximum-likelihood track-before-detect; see `docs/design.md`.
    """
    place = _place(state[0], state[1], scan, params)
    report = _report(place.beams, _table(scan, params))
    return jnp.where(scan.valid, jnp.log(_ratio(place, report, params)[0]), 0.0)


def beam_responsibility(state: Array, scan: BeamScan, params: BeamSensor) -> Array:
    """Return the posterior probability that each beam's detection is the target's, [B].

        r_b = Q P(b | u) w_b (1 − P_M) N(r_b; ρ, σ²) ρ_D / P_F / Λ,   with o = 0

    Args:
        state: [4] x, y, vx, vy at the look's time.
        scan: one look.
        params: as in `beam_log_likelihood_ratio`.

    Note:
        That another target answers (o) is left out: it would leave o / P_F of every detection
        unexplained, and where false alarms are rare a second track would live on that.

    Example:
        >>> from jaxtrack.types import Pose
        >>> scan = BeamScan(jnp.array(0.0), jnp.array(True), jnp.full(9, 50.0),
        ...                 jnp.arange(9) == 4, Pose(jnp.zeros(2), jnp.array(0.0)))
        >>> claims = beam_responsibility(jnp.array([50.0, 0.0, 0.0, 0.0]), scan, BeamSensor())
        >>> print(claims[3:6].round(2))
        [0. 1. 0.]
    """
    params = params._replace(p_other=0.0)
    place = _place(state[0], state[1], scan, params)
    total, own = _ratio(place, _report(place.beams, _table(scan, params)), params)
    beam = jnp.arange(scan.mask.shape[0], dtype=jnp.int32)
    nearest = _nearest(place.beams, scan.mask.shape[0])
    claims = sum(
        jnp.where(beam == n - _PAD, o / total, 0.0) for n, o in zip(nearest, own, strict=True)
    )
    return jnp.where(scan.valid & scan.mask, claims, 0.0)


def beam_scores(states: Array, scans: BeamScan, params: BeamSensor) -> Array:
    """Return the log-likelihood ratio of a window for many trajectories at once, [H].

    The sum of `beam_log_likelihood_ratio` over the looks. Places, reports and ratios are made in
    three loops over the looks: within one, the compiler would make places anew for every gather.

    Args:
        states: [H, 4] at the time of the last look.
        scans: K looks stacked.
        params: the sonar and the blur of its beams' edges.

    Example:
        >>> from jaxtrack.types import Pose
        >>> scans = BeamScan(jnp.zeros(1), jnp.ones(1, bool), jnp.full((1, 9), 50.0),
        ...                  jnp.arange(9)[None] == 4, Pose(jnp.zeros((1, 2)), jnp.zeros(1)))
        >>> print(beam_scores(jnp.array([[50.0, 0.0, 0.0, 0.0]]), scans, BeamSensor()).round(2))
        [3.82]
    """
    x, y, vx, vy = states.T
    scans = scans._replace(time_s=look_times(scans)[0])
    at = lambda scan: _place(x + vx * scan.time_s, y + vy * scan.time_s, scan, params)
    places = jax.lax.map(at, scans)
    reports = jax.lax.map(
        lambda look: _report(look[0], _table(look[1], params)), (places.beams, scans)
    )

    def look(total: Array, one: tuple[_Place, _Report, Array]) -> tuple[Array, None]:
        place, report, valid = one
        ratio = jnp.log(_ratio(place, report, params)[0])
        return total + jnp.where(valid, ratio, 0.0), None

    return jax.lax.scan(look, jnp.zeros_like(x), (places, reports, scans.valid))[0]


def beam_refine(state: Array, scans: BeamScan, params: BeamSensor) -> Array:
    """Return the trajectory fitted to the detections that a trajectory claims: one EM step.

        x' = x + J⁻¹ Σ_kb r_kb [∇ρ_k (r_kb − ρ_k)/σ² + ∇u_k (b + ½ − u_k)/(1/12 + s_b²)]

    with ranges and bearings linearized where the trajectory is, the beams taken as Gaussian, and J
    the information of `beam_information`. Where that is singular the state stays.

    Args:
        state: [4] at the time of the last look.
        scans: K looks stacked.
        params: the sonar and the blur of its beams' edges.
    """
    information, slope = _normal_equations(state, scans, params)
    inverse, definite = scaled_inverse(information)
    return state + jnp.where(definite, inverse @ slope, 0.0)


def beam_information(state: Array, scans: BeamScan, params: BeamSensor) -> Array:
    """Return what the detections that a trajectory claims tell about it, [4, 4].

        J = Σ_kb r_kb [∇ρ_k ∇ρ_kᵀ/σ² + ∇u_k ∇u_kᵀ/(1/12 + s_b²)]

    Args:
        state: [4] at the time of the last look.
        scans: K looks stacked.
        params: the sonar and the blur of its beams' edges.
    """
    return _normal_equations(state, scans, params)[0]


def beam_positions(scans: BeamScan, params: BeamSensor) -> Scan:
    """Return the looks as positions on the beams' axes, [K, B].

    Args:
        scans: K looks stacked.
        params: the sonar.
    """
    counts = scans.mask & scans.valid[:, None]
    range_m = jnp.where(counts, scans.range_m, 1.0)
    bearing = beam_bearings(params.sonar, beams=range_m.shape[1], dtype=range_m.dtype)
    place = jax.vmap(lambda r, pose: polar_to_earth(r, bearing, pose, params.sonar.mount_m))
    position_m = place(range_m, jax.vmap(_pose)(scans))
    return Scan(scans.time_s, scans.valid, position_m, counts, weight=scans.weight)


def blur_beams(params: BeamSensor, factor: Array | float) -> BeamSensor:
    """Return the sensor with its range noise and its beams' edges blurred, 1.3: by 0.4 beams."""
    sonar = params.sonar._replace(sigma_m=factor * params.sonar.sigma_m)
    return params._replace(sonar=sonar, spread_beams=params.spread_beams + (factor - 1) * 4 / 3)


def check_beam_looks(scans: BeamScan, params: BeamSensor) -> BeamScan:
    """Return sound looks, [K] stacked, of a sonar that can be.

    Raises:
        TypeError: ranges are not floating numbers.
        ValueError: a shape does not fit, or a known value cannot be.
    """
    check_sonar(params.sonar)
    dtype = jnp.result_type(float)
    check_positive("sensor.sonar.sigma_m", params.sonar.sigma_m, dtype)
    check_positive("sensor.spread_beams", params.spread_beams, dtype)
    check_probability("sensor.p_other", params.p_other, dtype)
    return check_beam_scans(scans)


BEAMS = Observation(
    log_likelihood_ratio=beam_log_likelihood_ratio,
    scores=beam_scores,
    responsibility=beam_responsibility,
    refine=beam_refine,
    blur=blur_beams,
    positions=beam_positions,
    information=beam_information,
    check=check_beam_looks,
)


def _normal_equations(state: Array, scans: BeamScan, params: BeamSensor) -> tuple[Array, Array]:
    """Return the information [4, 4] and the slope [4] of the linearized fit."""
    dt, _ = look_times(scans)
    x, y = state[0] + state[2] * dt, state[1] + state[3] * dt

    def look(x: Array, y: Array, scan: BeamScan) -> tuple[Array, Array]:
        place = _place(x, y, scan, params)
        report = _report(place.beams, _table(scan, params))
        total, own = _ratio(place, report, params)
        claim = [jnp.where(scan.valid, one / total, 0.0) for one in own]
        width = jnp.asarray(params.sonar.sector_rad, state.dtype) / scan.mask.shape[0]
        heading = _pose(scan).heading_rad
        cos, sin = jnp.cos(heading), jnp.sin(heading)
        along = jnp.stack(
            [cos * place.ahead_m - sin * place.starboard_m,
             sin * place.ahead_m + cos * place.starboard_m]
        )  # fmt: skip
        along = safe_divide(along, place.range_m)
        across = safe_divide(jnp.stack([-along[1], along[0]]), place.range_m * width)
        range_var = jnp.asarray(params.sonar.sigma_m, state.dtype) ** 2
        beam_var = 1 / 12 + jnp.asarray(params.spread_beams, state.dtype) ** 2
        middle = jnp.floor(place.beams) - place.beams
        far = sum(c * (r - place.range_m) for c, r in zip(claim, report.range_m, strict=True))
        off = sum(c * (middle + n) for c, n in zip(claim, (-0.5, 0.5, 1.5), strict=True))
        far, off = far / range_var, off / beam_var
        outer = along[:, None] * along[None, :] / range_var
        outer = outer + across[:, None] * across[None, :] / beam_var
        return sum(claim) * outer, far * along + off * across

    outer, push = jax.vmap(look)(x, y, scans)
    powers = jnp.stack([jnp.ones_like(dt), dt], axis=-1)
    information = jnp.einsum("kp,kq,kij->piqj", powers, powers, outer).reshape(4, 4)
    return information, jnp.einsum("kp,ki->pi", powers, push).reshape(4)


def _pose(scan: BeamScan) -> Pose:
    """Where the carrier is; somewhere, in a look that never was."""
    return jax.tree.map(lambda x: jnp.where(scan.valid, x, jnp.zeros_like(x)), scan.pose)


def _table(scan: BeamScan, params: BeamSensor) -> tuple[Array, Array, Array]:
    """Ranges, peaks and rests of one look's beams, with beams that do not exist at both ends."""
    sonar, dtype = params.sonar, scan.range_m.dtype
    cast = lambda x: jnp.asarray(x, dtype)
    miss, false, clutter, other = (
        cast(x) for x in (sonar.p_miss, sonar.p_false, sonar.clutter_in_missed_beam, params.p_other)
    )
    alone = 1 - other
    counts = scan.mask & scan.valid
    weight = jnp.ones_like(scan.range_m) if scan.weight is None else scan.weight
    weight = jnp.where(counts, weight, 0.0)
    normal = cast(sonar.range_max_m) / (cast(sonar.sigma_m) * math.sqrt(2 * math.pi))
    peak = weight * (alone * (1 - miss) * normal / false)
    something = alone * miss * clutter + other / false
    silence = alone * miss * (1 - clutter * false) / (1 - false)
    rest = jnp.where(counts, 1 + weight * (something - 1), silence)
    range_m = jnp.where(counts, scan.range_m, 0.0)
    return jnp.pad(range_m, _PAD), jnp.pad(peak, _PAD), jnp.pad(rest, _PAD, constant_values=1.0)


def _nearest(beams: Array, count: int) -> _Three:
    """Places in the table of the three beams nearest to a bearing."""
    middle = jnp.clip(jnp.floor(beams).astype(jnp.int32), -2, count + 1) + _PAD
    return middle - 1, middle, middle + 1


def _report(beams: Array, table: tuple[Array, Array, Array]) -> _Report:
    nearest = _nearest(beams, table[0].shape[0] - 2 * _PAD)
    port, middle, starboard = nearest
    return _Report(*((column[port], column[middle], column[starboard]) for column in table))


def _place(x: Array, y: Array, scan: BeamScan, params: BeamSensor) -> _Place:
    """Earth to sonar, with the bearing in beams."""
    sonar, pose = params.sonar, _pose(scan)
    mount = jnp.asarray(sonar.mount_m, x.dtype)
    north, east = x - pose.position_m[0], y - pose.position_m[1]
    cos, sin = jnp.cos(pose.heading_rad), jnp.sin(pose.heading_rad)
    ahead = cos * north + sin * east - mount[0]
    starboard = cos * east - sin * north - mount[1]
    count = scan.mask.shape[0]
    beams = angle(starboard, ahead) * (count / jnp.asarray(sonar.sector_rad, x.dtype)) + count / 2
    return _Place(safe_sqrt(ahead**2 + starboard**2), beams, ahead, starboard)


def _ratio(place: _Place, report: _Report, params: BeamSensor) -> tuple[Array, _Three]:
    """Likelihood ratio, and the parts of it that the detections of the three beams give.

    What lies beyond the three beams is the outer ones'.
    """
    cast = lambda x: jnp.asarray(x, place.range_m.dtype)
    sigma, scope = cast(params.sonar.sigma_m), cast(params.sonar.range_max_m)
    within = place.beams - jnp.floor(place.beams)
    spread = cast(params.spread_beams)
    port, starboard = _phi(-within / spread), _phi((within - 1) / spread)
    inside = _phi((scope - place.range_m) / sigma)
    total, own = 1 - inside + _LEAST, []
    shares = port, 1 - port - starboard, starboard
    for share, range_m, peak, rest in zip(shares, *report, strict=True):
        density = jnp.exp(-(((range_m - place.range_m) / sigma) ** 2) / 2)
        seen = inside * share * peak * density
        total = total + (seen + inside * share * rest)
        own.append(seen)
    return total, tuple(own)


def _phi(z: Array) -> Array:
    return 0.5 * (1 + jax.lax.erf(z * math.sqrt(0.5)))


def _arctangent_series(terms: int = 11) -> list[float]:
    """Coefficients c of arctan(t)/t ≈ Σ c_n t^2n on [0, 1], by Chebyshev interpolation."""
    squared = (1 - np.cos(np.pi * (np.arange(terms) + 0.5) / terms)) / 2
    root = np.sqrt(squared)
    fit = np.polynomial.Polynomial.fit(squared, np.arctan(root) / root, terms - 1, domain=[0, 1])
    return fit.convert().coef.tolist()


_SERIES = _arctangent_series()


def angle(y: Array, x: Array) -> Array:
    """Return the angle of (x, y) in [−π, π] to 1e-8 rad: on a CPU several times faster than atan2.

    Args:
        y: any shape.
        x: the same shape and unit. At the origin the angle is 0, with gradient 0.

    Example:
        >>> print(f"{angle(jnp.array(1.0), jnp.array(-1.0)):.5f}")
        2.35619
    """
    steep = jnp.abs(y) > jnp.abs(x)
    low, high = jnp.where(steep, x, y), jnp.where(steep, y, x)
    t = safe_divide(low, high)
    squared = t * t
    value = jnp.full_like(t, _SERIES[-1])
    for coefficient in _SERIES[-2::-1]:
        value = value * squared + coefficient
    value = value * t
    # (high, low) within 45° of an axis: which axis is known from the signs.
    back = jnp.where(y < 0, -math.pi, math.pi)
    flat = jnp.where(x < 0, value + back, value)
    return jnp.where(steep, jnp.where(y < 0, -math.pi / 2, math.pi / 2) - value, flat)
