"""What one look of a multi-beam sonar says about a target in a given state.

The likelihood of a look, as a target at the state makes it, against that of an empty look
(`beam_ratio`): for one state, for many trajectories; and the fit of a trajectory to the detections
that it claims.
"""

import jax
import jax.numpy as jnp

from jaxtrack.models.beam_place import Place, place_of, pose_of
from jaxtrack.models.beam_ratio import PAD, BeamSensor, Report, nearest_beams, ratio_of, report_of
from jaxtrack.models.frames import polar_to_earth
from jaxtrack.models.motion import look_times
from jaxtrack.models.observation import Observation
from jaxtrack.models.sonar import beam_bearings, check_sonar
from jaxtrack.numerics.checks import (
    check_beam_scans,
    check_known,
    check_positive,
    check_probability,
)
from jaxtrack.numerics.definite import scaled_inverse
from jaxtrack.numerics.safe import safe_divide
from jaxtrack.types import Array, BeamScan, Scan


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
    place = place_of(state[0], state[1], scan, params.sonar)
    report = report_of(place.beams, scan, params)
    return jnp.where(scan.valid, jnp.log(ratio_of(place, report, params)[0]), 0.0)


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
    place = place_of(state[0], state[1], scan, params.sonar)
    total, own = ratio_of(place, report_of(place.beams, scan, params), params)
    beam = jnp.arange(scan.mask.shape[0], dtype=jnp.int32)
    nearest = nearest_beams(place.beams, scan.mask.shape[0])
    claims = sum(
        jnp.where(beam == n - PAD, o / total, 0.0) for n, o in zip(nearest, own, strict=True)
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
    at = lambda scan: place_of(x + vx * scan.time_s, y + vy * scan.time_s, scan, params.sonar)
    places = jax.lax.map(at, scans)
    reports = jax.lax.map(lambda at: report_of(at[0], at[1], params), (places.beams, scans))

    def look(total: Array, one: tuple[Place, Report, Array]) -> tuple[Array, None]:
        place, report, valid = one
        ratio = jnp.log(ratio_of(place, report, params)[0])
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
    position_m = place(range_m, jax.vmap(pose_of)(scans))
    return Scan(scans.time_s, scans.valid, position_m, counts, weight=scans.weight)


def blur_beams(params: BeamSensor, factor: Array | float) -> BeamSensor:
    """Return the sensor with its range noise and its beams' edges blurred, 1.3: by 0.4 beams."""
    sonar = params.sonar._replace(sigma_m=factor * params.sonar.sigma_m)
    return params._replace(sonar=sonar, spread_beams=params.spread_beams + (factor - 1) * 4 / 3)


def check_beam_looks(scans: BeamScan, params: BeamSensor) -> BeamScan:
    """Return sound looks, [K] stacked, of a sonar that can be.

    Raises:
        TypeError: looks or sensor are not those of beams, or ranges are not floating numbers.
        ValueError: a shape does not fit, or a known value cannot be.
    """
    scans = check_beam_scans(scans)
    if not isinstance(params, BeamSensor):
        raise TypeError(f"sensor: got a {type(params).__name__}, want a BeamSensor")
    check_sonar(params.sonar)
    between = "a probability between 0 and 1, for a ratio to clutter"
    check_known("sensor.sonar.p_false", params.sonar.p_false, lambda p: (p > 0) & (p < 1), between)
    dtype = jnp.result_type(float)
    check_positive("sensor.sonar.sigma_m", params.sonar.sigma_m, dtype)
    check_positive("sensor.spread_beams", params.spread_beams, dtype)
    check_probability("sensor.p_other", params.p_other, dtype)
    return scans


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
        place = place_of(x, y, scan, params.sonar)
        report = report_of(place.beams, scan, params)
        total, own = ratio_of(place, report, params)
        claim = [jnp.where(scan.valid, one / total, 0.0) for one in own]
        width = jnp.asarray(params.sonar.sector_rad, state.dtype) / scan.mask.shape[0]
        heading = pose_of(scan).heading_rad
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
