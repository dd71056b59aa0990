"""Tracks of targets whose lines n = n0 + v t are known in both coordinates."""

import jax
import jax.numpy as jnp

from jaxtrack.hough.slope_intercept import LineGrid, Points
from jaxtrack.hough.tracks import tentative_tracks
from jaxtrack.types import Array, Tracks


def misses(points: Points, line: Array) -> Array:
    """Return how far each point is from each line at its time, [M, K, N].

    Args:
        points: K looks of N points.
        line: [M, 2] v and n0.

    Example:
        >>> points = Points(jnp.array([[2.0]]), jnp.array([[9.0]]), jnp.ones((1, 1)))
        >>> print(misses(points, jnp.array([[3.0, 1.0]])))
        [[[2.]]]

    Source: clustering-statistic Hough transform (2018), equation 41.
    """
    at = line[:, 1, None, None] + line[:, 0, None, None] * points.time_s[None]
    return points.position_m[None] - at


def line_tracks(
    points: tuple[Points, Points],
    lines: tuple[Array, Array],
    grids: tuple[LineGrid, LineGrid],
    end_s: Array,
    span_s: Array,
    group: Array,
    there: Array,
    *,
    existence: Array,
    sigma_m: Array | float,
) -> tuple[Tracks, Array]:
    """Return tracks at the window's end, and their states x0, y0, vx, vy at its start, [M, 4].

    A track's score is the weight of its own detections within a cell of its lines; its covariance
    is that of least squares through them.

    Args:
        points: detections along x and along y.
        lines: [M, 2] v and n0 of every target along x and along y.
        grids: whose cells count, along x and along y.
        end_s: [] time of the window's end.
        span_s: [] of the window.
        group: [M, K, N] how far each detection belongs to each target.
        there: [M] which targets there are; those without any detection fall away.
        existence: [M].
        sigma_m: noise of a position.
    """
    dtype = group.dtype
    velocity = jnp.stack([line[:, 0] for line in lines], axis=-1)
    start = jnp.stack([line[:, 1] for line in lines], axis=-1)
    mean = jnp.concatenate([start + velocity * span_s, velocity], axis=-1)
    own = group * points[0].weight[None]
    near = own
    for along, line, grid in zip(points, lines, grids, strict=True):
        inside = jnp.abs(misses(along, line)) <= jnp.asarray(grid.position_step_m, dtype)
        near = jnp.where(inside, near, 0.0)
    keep = there & (own.sum((1, 2)) > 0)
    covariance = jax.vmap(lambda w: _covariance(points[0].time_s - span_s, w))(near)
    covariance = covariance * jnp.asarray(sigma_m, dtype) ** 2
    tracks = tentative_tracks(
        end_s, mean, covariance, keep, existence=existence, log_score=near.sum((1, 2))
    )
    initial = jnp.concatenate([start, velocity], axis=-1)
    return tracks, jnp.where(keep[:, None], initial, 0.0)


def _covariance(time: Array, weight: Array) -> Array:
    """Return (Σ w a aᵀ)⁻¹ with a = [1, t] of both coordinates, [4, 4], in the order x, y, vx, vy.

    A tiny prior keeps it finite where the points do not fix a line.
    """
    least = jnp.asarray(1e-6, time.dtype)
    s0 = weight.sum() + least
    s1 = (weight * time).sum()
    s2 = (weight * time * time).sum() + least
    # s0 s2 − s1² as a sum of squares about the mean keeps its digits.
    mean = s1 / s0
    spread = (weight * (time - mean) ** 2).sum() + least * (1 + mean * mean)
    position, velocity, cross = s2 / (s0 * spread), 1 / spread, -s1 / (s0 * spread)
    block = jnp.stack([jnp.stack([position, cross]), jnp.stack([cross, velocity])])
    return jnp.kron(block, jnp.eye(2, dtype=time.dtype))
