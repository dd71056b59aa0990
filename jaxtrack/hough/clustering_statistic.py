"""Clustering-statistic Hough transform (CSHT), and the transform with a threshold alone (SHT).

One coordinate over time votes for velocities and initial positions; the cells with more than a
share of the strongest one's votes are clustered by fuzzy ISODATA, a sample of a cell for each of
its votes. Every cluster is a target. Detections go to the target nearest in the first coordinate,
and in the second coordinate each target's detections give a single line.
"""

from typing import NamedTuple

import jax
import jax.numpy as jnp

from jaxtrack.clustering import Isodata, farthest_first, isodata
from jaxtrack.hough.clustering_params import ClusteringParams, ClusteringSizes, check_clustering
from jaxtrack.hough.line_cells import Cells, cells_above, single_line
from jaxtrack.hough.line_tracks import line_tracks, misses
from jaxtrack.hough.slope_intercept import (
    Points,
    grouped_votes,
    hard_votes,
    points_of,
    soft_votes,
    start_time,
)
from jaxtrack.models.motion import look_times
from jaxtrack.numerics.checks import check_positive
from jaxtrack.numerics.safe import safe_divide
from jaxtrack.types import Array, Key, Scan, Tracks


class ClusteringInfo(NamedTuple):
    """What the estimator saw."""

    initial: Array  # [M, 4]  x0, y0, vx, vy at the window's first look
    group: Array  # [M, K, N] how far each detection belongs to each target
    cells: Cells
    clusters: Isodata | None  # None: by threshold alone
    overflow: Array  # []


def estimate(
    scans: Scan,
    params: ClusteringParams,
    key: Key | None = None,
    *,
    sizes: ClusteringSizes | None = None,
) -> tuple[Tracks, ClusteringInfo]:
    """Return the targets of a window by the clustering-statistic Hough transform.

    Args:
        scans: K looks stacked, in the earth frame.
        params: grids, thresholds, clustering.
        key: not used; part of every window estimator's signature.
        sizes: static sizes; the defaults if None.

    Returns:
        Tracks at the time of the last valid look, [x, y, vx, vy], and what led to them. Their
        `log_score` is the weight of the detections within a cell of the track, not a likelihood
        ratio, and `existence` the aggregation degree of the cluster.

    Raises:
        ValueError: shapes do not fit, or a size is too small.

    Example:
        >>> time = jnp.arange(20.0) / 2
        >>> position = jnp.stack([60 - 2 * time, 10 + time], axis=-1)[:, None]
        >>> scans = Scan(time, time >= 0, position, jnp.ones((20, 1), bool))
        >>> tracks, _ = estimate(scans, ClusteringParams())
        >>> error = jnp.abs(tracks.mean[:, 2:] - jnp.array([[-2.0, 1.0]])).max(-1)
        >>> print(bool(error.min() < 0.4))
        True

    Source: clustering-statistic Hough transform (2018), algorithm 1 and equations 6–41.

    Note:
        The covariance is that of least squares through the track's own detections, with noise σ.
        The last two clusters never merge: their distance is D itself, and M_ind is less.
        The paper leaves the samples' units open. Here they are (scale · v, n0 + τ v): at the
        window's start v and n0 of a target's cells are correlated, towards mid-window they are not,
        and its cluster is as round as c-means takes it to be. τ = 0 clusters (v, n0) as printed.
    """
    scans, sizes = check_clustering(scans, params, sizes)
    x, y = points = points_of(scans, 0), points_of(scans, 1)
    votes = hard_votes(x, params.x, sizes=sizes.lines)
    cells = cells_above(votes, params.cell_share, params.x, cells=sizes.cells, sizes=sizes.lines)
    clusters, line = _cluster(cells, params, sizes)
    active = clusters.active[:, None, None]
    nearest = jnp.argmin(jnp.where(active, jnp.abs(misses(x, line)), jnp.inf), axis=0)
    group = nearest[None] == jnp.arange(sizes.patterns)[:, None, None]
    group = (group & active).astype(votes.dtype)
    votes = grouped_votes(y, nearest, params.y, groups=sizes.patterns, sizes=sizes.lines)
    read = lambda v: single_line(v, params.line_share, params.y, sizes=sizes.lines)
    return _finish(scans, params, points, (line, jax.vmap(read)(votes)), group, cells, clusters)


def soft_estimate(
    scans: Scan,
    params: ClusteringParams,
    tolerance_m: Array | float,
    temperature: Array | float,
    key: Key | None = None,
    *,
    sizes: ClusteringSizes | None = None,
) -> tuple[Tracks, ClusteringInfo]:
    """Return the targets as `estimate` does, differentiably.

    Votes are Gaussians, thresholds are sigmoids and detections are shared between targets by the
    Gaussian of their distance; the clusters' gradient is that of their fixed point. How many
    clusters there are is decided, and has no gradient; `info.clusters.survival` says by which share
    each withstood the thresholds of ISODATA, and has one. Tends to `estimate` as both tolerances
    vanish (and the votes' nodes with them: `LineSizes.fine`).

    Args:
        scans: K looks stacked.
        params: grids, thresholds, clustering.
        tolerance_m: [] standard deviation of a vote and of the association.
        temperature: [] width of the thresholds, as a share of the peak, and of ISODATA's.
        key: not used; part of every window estimator's signature.
        sizes: static sizes; the defaults if None.

    Raises:
        ValueError: shapes do not fit, a size is too small, or a tolerance is not positive.
    """
    scans, sizes = check_clustering(scans, params, sizes)
    dtype = scans.position_m.dtype
    tolerance = check_positive("tolerance_m", tolerance_m, dtype)
    width = check_positive("temperature", temperature, dtype)
    x, y = points = points_of(scans, 0), points_of(scans, 1)
    votes = soft_votes(x, params.x, tolerance, sizes=sizes.lines)
    cells = cells_above(
        votes,
        params.cell_share,
        params.x,
        cells=sizes.cells,
        sizes=sizes.lines,
        temperature=width,
    )
    clusters, line = _cluster(cells, params, sizes, width)
    square = (misses(x, line) / tolerance) ** 2 / 2
    active = clusters.active[:, None, None]
    fixed = jnp.where(active, jax.lax.stop_gradient(square), jnp.inf)
    least = jnp.where(clusters.active.any(), fixed.min(0), 0.0)
    raw = jnp.where(active, jnp.exp(jnp.where(active, least[None] - square, 0.0)), 0.0)
    group = safe_divide(raw, raw.sum(0)[None])

    def read(own: Array) -> Array:
        mine = y._replace(weight=y.weight * own)
        votes = soft_votes(mine, params.y, tolerance, sizes=sizes.lines)
        return single_line(votes, params.line_share, params.y, sizes=sizes.lines, temperature=width)

    return _finish(scans, params, points, (line, jax.vmap(read)(group)), group, cells, clusters)


def threshold_estimate(
    scans: Scan,
    params: ClusteringParams,
    key: Key | None = None,
    *,
    sizes: ClusteringSizes | None = None,
) -> tuple[Tracks, ClusteringInfo]:
    """Return the standard Hough transform's targets: every cell above the threshold is one.

    As many cells as pass `cell_share` of the peak around one target, so many targets there are:
    what clustering is for. `sizes.patterns` of them are returned, the strongest first.

    Args:
        scans: K looks stacked, in the earth frame.
        params: grids and thresholds.
        key: not used; part of every window estimator's signature.
        sizes: static sizes; the defaults if None.

    Raises:
        ValueError: shapes do not fit, or a size is too small.

    Example:
        >>> time = jnp.arange(20.0) / 2
        >>> position = jnp.stack([60 - 2 * time, 10 + time], axis=-1)[:, None]
        >>> scans = Scan(time, time >= 0, position, jnp.ones((20, 1), bool))
        >>> tracks, _ = threshold_estimate(scans, ClusteringParams(cell_share=0.9))
        >>> print(tracks.mask.sum() > 1)
        True

    Source: clustering-statistic Hough transform (2018), section III-B, first paragraph.

    Note:
        A detection votes in the second coordinate for every line within a cell of it.
    """
    scans, sizes = check_clustering(scans, params, sizes)
    x, y = points = points_of(scans, 0), points_of(scans, 1)
    votes = hard_votes(x, params.x, sizes=sizes.lines)
    cells = cells_above(votes, params.cell_share, params.x, cells=sizes.patterns, sizes=sizes.lines)
    line = jnp.stack([cells.velocity_m_s, cells.position_m], axis=-1)
    # The lines of one target are neighbours: each gets all detections within a cell of it.
    near = jnp.abs(misses(x, line)) <= jnp.asarray(params.x.position_step_m, votes.dtype)
    group = (near & cells.mask[:, None, None]).astype(votes.dtype)

    def read(own: Array) -> Array:
        mine = y._replace(weight=y.weight * own)
        votes = hard_votes(mine, params.y, sizes=sizes.lines)
        return single_line(votes, params.line_share, params.y, sizes=sizes.lines)

    return _finish(scans, params, points, (line, jax.vmap(read)(group)), group, cells, None)


def _cluster(
    cells: Cells, params: ClusteringParams, sizes: ClusteringSizes, width: Array | None = None
) -> tuple[Isodata, Array]:
    """Return the clusters of the cells, and their lines (v, n0), [M, 2]."""
    dtype = cells.votes.dtype
    scale, later = (jnp.asarray(x, dtype) for x in (params.velocity_scale_s, params.cluster_time_s))
    velocity = cells.velocity_m_s
    samples = jnp.stack([scale * velocity, cells.position_m + later * velocity], axis=-1)
    fixed = jax.lax.stop_gradient(samples)
    first = farthest_first(
        fixed, jax.lax.stop_gradient(cells.votes), mask=cells.mask, clusters=sizes.start
    )
    first = jnp.pad(first, (0, sizes.patterns - sizes.start), constant_values=-1)
    # The gradient is that of the fixed point: it is as far off as the centres are.
    tolerance = 1e-4 if width is None else min(1e-4, float(jnp.finfo(dtype).eps) ** 0.5)
    clusters = isodata(
        samples,
        cells.votes,
        fixed[jnp.where(first < 0, 0, first)],
        mask=cells.mask,
        active=first >= 0,
        params=params.isodata,
        tolerance=tolerance,
        sizes=sizes.isodata,
        width=width,
    )
    velocity = clusters.centres[:, 0] / scale
    return clusters, jnp.stack([velocity, clusters.centres[:, 1] - later * velocity], axis=-1)


def _finish(
    scans: Scan,
    params: ClusteringParams,
    points: tuple[Points, Points],
    lines: tuple[Array, Array],
    group: Array,
    cells: Cells,
    clusters: Isodata | None,
) -> tuple[Tracks, ClusteringInfo]:
    """Return the tracks of lines (v, n0) [M, 2] in both coordinates, and the info."""
    _, end_s = look_times(scans)
    if clusters is None:
        there, existence = cells.mask, safe_divide(cells.votes, cells.votes[0])
    else:
        there, existence = clusters.active, clusters.aggregation
    tracks, initial = line_tracks(
        points,
        lines,
        (params.x, params.y),
        end_s,
        end_s - start_time(scans),
        group,
        there,
        existence=existence,
        sigma_m=params.sigma_m,
    )
    return tracks, ClusteringInfo(initial, group, cells, clusters, cells.overflow)
