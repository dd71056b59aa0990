"""From lines to tracks: who belongs to a line, and how it moves along it.

A line has no time. Of the detections near it those are the target's that also move evenly along
it: the speed that most looks agree on, among all pairs of detections near the line. The chosen
detections are smoothed by recursive least squares.
"""

from typing import NamedTuple

import jax
import jax.numpy as jnp

from jaxtrack.filtering.rls import RlsInput, RlsParams, rls
from jaxtrack.hough.pairs import SpeedGate, check_speeds, counting, detection_times
from jaxtrack.models.line import point_line_distance
from jaxtrack.models.motion import look_times
from jaxtrack.numerics.checks import check_known, check_positive, check_scans, check_size
from jaxtrack.numerics.safe import safe_min
from jaxtrack.types import Array, Lines, Scan, Stage, Tracks


class InitiateParams(NamedTuple):
    """Parameters of track initiation. Traced."""

    member_m: Array | float = 60.0  # detections farther from the line do not belong to it
    along_m: Array | float = 90.0  # nor those farther from where the target should be along it
    sigma_m: Array | float = 10.0  # noise of a detection, for the covariance
    speed: SpeedGate = SpeedGate()
    forgetting: Array | float = 1.0  # of the recursive least squares
    min_looks: Array | int = 3  # tracks with fewer detections are masked out


class InitiateInfo(NamedTuple):
    """What people look at."""

    member: Array  # [M, K] index of each look's detection; −1: none
    smoothed_m: Array  # [M, K, 2] positions after each look's update


def initiate(
    scans: Scan, lines: Lines, params: InitiateParams, *, nearest: int = 4
) -> tuple[Tracks, InitiateInfo]:
    """Return a track for every line that detections move along evenly.

    Args:
        scans: K looks stacked.
        lines: M lines, ρ from (0, 0).
        params: gates, noise and forgetting.
        nearest: how many detections of a look, the nearest to the line, are considered; static.

    Raises:
        TypeError: `nearest` is not a Python int.
        ValueError: a shape does not fit, or a known value cannot be.

    Returns:
        Tracks at the time of the last look, with the lines' votes as scores and existence 1 (a
        count of votes is no likelihood), and who belongs.

    Example:
        >>> scans = Scan(2.0 * jnp.arange(4.0), jnp.ones(4, bool),
        ...              jnp.stack([400.0 * jnp.arange(4.0), jnp.full(4, 80.0)], -1)[:, None],
        ...              jnp.ones((4, 1), bool))
        >>> line = Lines(*jnp.array([[80.0], [jnp.pi / 2], [3.0]]), jnp.ones(1, bool))
        >>> tracks, info = initiate(scans, line, InitiateParams(), nearest=1)
        >>> print(tracks.mean.round(), info.member)
        [[1200.   80.  200.    0.]] [[0 0 0 0]]

    Source: neutrosophic Hough transform (2018), figures 6 and 14 (recursive least squares).
    """
    check_size("nearest", nearest)
    scans = check_scans(scans)
    dtype = scans.position_m.dtype
    for name in ("member_m", "along_m", "sigma_m"):
        check_positive(f"params.{name}", getattr(params, name), dtype)
    check_speeds(params.speed)
    check_known("params.min_looks", params.min_looks, lambda n: n >= 1, "at least one look")
    number = lambda x: jnp.asarray(x, dtype)
    looks, detections = scans.mask.shape
    nearest = min(nearest, detections)
    counts = counting(scans)
    weight = jnp.ones(counts.shape, dtype) if scans.weight is None else scans.weight
    weight = jnp.where(counts, weight, 0.0)
    position = jnp.where(counts[..., None], scans.position_m, 0.0)
    before, end = look_times(scans)
    time = detection_times(scans) - end
    look = jnp.repeat(jnp.arange(looks), nearest)

    def one(rho: Array, theta: Array) -> tuple[Array, ...]:
        away = jnp.abs(point_line_distance(rho, theta, position))
        near = counts & (away <= number(params.member_m))
        _, index = jax.lax.top_k(jnp.where(near, -away, -jnp.inf), nearest)
        take = lambda x: jnp.take_along_axis(x, index, axis=1)
        near, t, w = take(near), take(time), take(weight)
        along = jnp.sin(theta) * position[..., 0] - jnp.cos(theta) * position[..., 1]
        s = take(along)
        # Every pair of kept detections of different looks is a hypothesis s₀ + v t.
        flat_s, flat_t, flat_near = s.ravel(), t.ravel(), near.ravel()
        dt = flat_t[:, None] - flat_t[None, :]
        pair = flat_near[:, None] & flat_near[None, :] & (look[:, None] > look[None, :]) & (dt > 0)
        v = (flat_s[:, None] - flat_s[None, :]) / jnp.where(pair, dt, 1.0)
        fast = (jnp.abs(v) >= number(params.speed.v_min_m_s)) & (
            jnp.abs(v) <= number(params.speed.v_max_m_s)
        )
        start = flat_s[None, :] - v * flat_t[None, :]
        pair, v, start = (pair & fast).ravel(), v.ravel(), start.ravel()
        miss = jnp.abs(s[None] - start[:, None, None] - v[:, None, None] * t[None])
        ratio = jnp.where(near[None], miss / number(params.along_m), jnp.inf)
        fits = w[None] * jnp.exp(-((3 * ratio) ** 2) / 2)
        support = jnp.where(pair, fits.max(-1).sum(-1), -1.0)
        best = jnp.argmax(support)
        ratio = jnp.where(pair[best], ratio[best], jnp.inf)
        chosen = jnp.argmin(ratio, axis=-1)[:, None]
        mine = jnp.take_along_axis(ratio, chosen, axis=-1)[:, 0] <= 1
        return mine, jnp.take_along_axis(index, chosen, axis=-1)[:, 0]

    # Line by line: the hypotheses of one line times all detections near it fill the cache.
    mine, index = jax.lax.map(lambda line: one(*line), (lines.rho_m, lines.theta_rad))
    mine = mine & lines.mask[:, None]

    def smooth(mine: Array, index: Array) -> tuple[Array, Array, Array]:
        z, t = position[jnp.arange(looks), index], time[jnp.arange(looks), index]
        # Far from its true values the regression starts at the first detection, not at zero.
        first = z[jnp.argmax(mine)]
        span = jnp.maximum(-safe_min(before), 1.0)
        phi = jnp.stack([jnp.ones_like(t), t / span], axis=-1)
        fit = rls(RlsParams(params.forgetting, 1e4), regressors=2, dimensions=2)
        begin = jax.tree.map(lambda x: x.astype(dtype), fit.init(jax.random.key(0)))
        inputs = RlsInput(phi, z - first[None], mine)
        state, smoothed = jax.lax.scan(fit.step, begin, inputs)
        velocity = state.coefficients[1] / span
        mean = jnp.concatenate([first + state.coefficients[0], velocity])
        scale = jnp.diag(jnp.stack([jnp.ones_like(span), 1 / span]))
        spread = number(params.sigma_m) ** 2 * scale @ state.inverse @ scale
        return mean, jnp.kron(spread, jnp.eye(2, dtype=dtype)), smoothed + first[None]

    mean, covariance, smoothed = jax.vmap(smooth)(mine, index)
    keep = lines.mask & (mine.sum(-1) >= params.min_looks)
    clear = lambda x: jnp.where(keep.reshape(-1, *(1,) * (x.ndim - 1)), x, 0.0)
    tracks = Tracks(
        time_s=end,
        mean=clear(mean),
        covariance=clear(covariance),
        mask=keep,
        identity=jnp.where(keep, jnp.arange(keep.shape[0]), -1),
        stage=jnp.where(keep, Stage.TENTATIVE, Stage.EMPTY),
        existence=keep.astype(dtype),
        log_score=clear(lines.votes),
    )
    member = jnp.where(mine & keep[:, None], index, -1)
    return tracks, InitiateInfo(member, clear(smoothed))
