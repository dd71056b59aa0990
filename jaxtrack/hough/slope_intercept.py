"""Slope–intercept Hough transform of positions over time along one coordinate.

A detection (t, n) lies on all lines n = n0 + v t with

    n0 = −t v + n,

one initial position for each velocity: it votes once in every row of a grid of velocities and
initial positions. `hard_votes` counts in cells; `soft_votes` counts Gaussians, differentiably.
"""

from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from jaxtrack.numerics.checks import check_array, check_positive, check_scans, check_size
from jaxtrack.types import Array, Scan


class LineGrid(NamedTuple):
    """Velocities v_min + i h_v, and cells [n_min + j h_n, n_min + (j + 1) h_n) of n0. Traced."""

    velocity_min_m_s: Array | float = -6.0
    velocity_step_m_s: Array | float = 0.15
    position_min_m: Array | float = -40.0
    position_step_m: Array | float = 4.0


class LineSizes(NamedTuple):
    """How many cells there are. Static."""

    velocities: int = 81
    positions: int = 65
    fine: int = 4  # nodes of the soft votes in a cell of n0


class Points(NamedTuple):
    """Weighted positions over time along one coordinate, look by look."""

    time_s: Array  # [K, N] from the time that n0 belongs to
    position_m: Array  # [K, N]
    weight: Array  # [K, N] zero for what is not there


def points_of(scans: Scan, coordinate: int) -> Points:
    """Return one coordinate of the detections over the time since the window's first valid look.

    Args:
        scans: K looks stacked.
        coordinate: 0 for x (north), 1 for y (east).

    Example:
        >>> scans = Scan(jnp.array([5.0, 6.0]), jnp.ones(2, bool), jnp.ones((2, 1, 2)),
        ...              jnp.array([[True], [False]]))
        >>> points = points_of(scans, 0)
        >>> print(points.time_s.ravel(), points.weight.ravel())
        [0. 0.] [1. 0.]

    Source: clustering-statistic Hough transform (2018), equations 10–13.
    """
    scans = check_scans(scans)
    counts = scans.mask & scans.valid[:, None]
    dtype = scans.position_m.dtype
    time = jnp.where(scans.valid, scans.time_s - start_time(scans), 0.0)[:, None]
    if scans.delay_s is not None:
        time = time + scans.delay_s
    weight = jnp.ones(counts.shape, dtype) if scans.weight is None else scans.weight
    hide = lambda x: jnp.where(counts, x, 0.0)
    return Points(
        hide(jnp.broadcast_to(time, counts.shape)),
        hide(scans.position_m[:, :, coordinate]),
        hide(weight),
    )


def start_time(scans: Scan) -> Array:
    """Return the time of the first valid look, [], to which initial positions belong; 0 if none.

    Example:
        >>> scans = Scan(jnp.array([4.0, 5.0]), jnp.array([False, True]), jnp.zeros((2, 1, 2)),
        ...              jnp.zeros((2, 1), bool))
        >>> print(start_time(scans))
        5.0
    """
    first = jnp.argmax(scans.valid)
    return jnp.where(scans.valid.any(), scans.time_s[first], 0.0)


def cell_centres(grid: LineGrid, *, sizes: LineSizes, dtype: jnp.dtype) -> tuple[Array, Array]:
    """Return the velocities [V] and the middles of the cells of n0 [P].

    Example:
        >>> velocity, position = cell_centres(LineGrid(), sizes=LineSizes(2, 2), dtype=jnp.float32)
        >>> print(velocity, position)
        [-6.   -5.85] [-38. -34.]

    Source: clustering-statistic Hough transform (2018), equations 8 and 9.

    Note:
        Votes in [n0_j, n0_j + h) stand for the middle, not for n0_j: half a cell less bias.
    """
    v_min, v_step, low, step = (jnp.asarray(x, dtype) for x in grid)
    velocity = v_min + v_step * jnp.arange(sizes.velocities).astype(dtype)
    return velocity, low + step * (jnp.arange(sizes.positions).astype(dtype) + 0.5)


def hard_votes(points: Points, grid: LineGrid, *, sizes: LineSizes) -> Array:
    """Count the votes in the cells of the grid, [V, P]; what falls outside is dropped.

        V_ij = Σ_q w_q [n0_j ≤ n_q − t_q v_i < n0_j + h]

    Args:
        points: K looks of N points.
        grid: where the cells lie.
        sizes: how many there are.

    Raises:
        ValueError: shapes do not fit, or a size is too small.

    Example:
        >>> points = Points(jnp.array([[0.0], [2.0]]), jnp.array([[9.0], [11.0]]), jnp.ones((2, 1)))
        >>> votes = hard_votes(points, LineGrid(-1.0, 1.0, 0.0, 4.0),
        ...                    sizes=LineSizes(velocities=3, positions=4))
        >>> print(votes)
        [[0. 0. 1. 1.]
         [0. 0. 2. 0.]
         [0. 0. 2. 0.]]

    Source: clustering-statistic Hough transform (2018), equations 7 and 14–16.
    """
    together = jnp.zeros(points.position_m.shape, jnp.int32)
    return grouped_votes(points, together, grid, groups=1, sizes=sizes)[0]


def grouped_votes(
    points: Points, group: Array, grid: LineGrid, *, groups: int, sizes: LineSizes
) -> Array:
    """Count the votes of each group of points by themselves, [G, V, P], as `hard_votes` does.

    Args:
        points: K looks of N points.
        group: [K, N] integers from 0 to G − 1.
        grid: where the cells lie.
        groups: G.
        sizes: how many cells there are.

    Raises:
        ValueError: shapes do not fit, or a size is too small.

    Example:
        >>> points = Points(jnp.zeros((1, 2)), jnp.array([[1.0, 5.0]]), jnp.ones((1, 2)))
        >>> print(grouped_votes(points, jnp.array([[0, 1]]), LineGrid(0.0, 1.0, 0.0, 4.0), groups=2,
        ...                     sizes=LineSizes(velocities=1, positions=2)))
        [[[1. 0.]]
        <BLANKLINE>
         [[0. 1.]]]
    """
    _check(points, sizes)
    check_size("groups", groups)
    dtype = points.position_m.dtype
    velocity, _ = cell_centres(grid, sizes=sizes, dtype=dtype)
    _, _, low, step = (jnp.asarray(x, dtype) for x in grid)
    time, position, weight = (x.ravel() for x in points)
    # A column more takes what falls outside: a scatter that is in bounds costs less.
    columns = sizes.positions + 1
    table = sizes.velocities * columns
    row = jnp.arange(sizes.velocities, dtype=jnp.int32) * columns
    place = jnp.floor((position[None, :] - time[None, :] * velocity[:, None] - low) / step)
    inside = (place >= 0) & (place < sizes.positions)
    cell = jnp.where(inside, place, float(sizes.positions)).astype(jnp.int32) + row[:, None]
    cell = cell + (group.ravel().astype(jnp.int32) * table)[None, :]
    vote = jnp.broadcast_to(weight[None, :], place.shape)
    flat = jnp.zeros(groups * table, dtype)
    flat = flat.at[cell.ravel()].add(vote.ravel(), mode="promise_in_bounds")
    return flat.reshape(groups, sizes.velocities, columns)[:, :, :-1]


def soft_votes(
    points: Points, grid: LineGrid, sigma_m: Array | float, *, sizes: LineSizes
) -> Array:
    """Count the share of each vote's Gaussian that falls into a cell, [V, P].

        V_ij ≈ Σ_q w_q [Φ((n0_j + h_n − r_qi)/σ) − Φ((n0_j − r_qi)/σ)],     r_qi = n_q − t_q v_i

    Votes are shared between the two nearest of nodes h = h_n / `fine` apart, and the nodes' votes
    are convolved with the Gaussian. That replaces the brackets by their linear interpolation: the
    error is at most h²/8 · 2 max|Φ''|/σ² = 0.0605 (h/σ)² of the weights. Tends to `hard_votes` as
    σ and h vanish; differentiable in points, weights and σ.

    Args:
        points: K looks of N points.
        grid: where the cells lie; votes outside fade out within h and are dropped.
        sigma_m: σ of a vote, > 0.
        sizes: how many cells there are, and `fine`.

    Raises:
        ValueError: shapes do not fit, or a size is too small.

    Example:
        >>> points = Points(jnp.zeros((1, 1)), jnp.array([[10.0]]), jnp.ones((1, 1)))
        >>> votes = soft_votes(points, LineGrid(-1.0, 1.0, 0.0, 4.0), 4.0,
        ...                    sizes=LineSizes(velocities=1, positions=4))
        >>> print(votes.round(2))
        [[0.06 0.24 0.38 0.24]]
    """
    _check(points, sizes)
    dtype = points.position_m.dtype
    sigma = check_positive("sigma_m", sigma_m, dtype)
    velocity, _ = cell_centres(grid, sizes=sizes, dtype=dtype)
    _, _, low, step = (jnp.asarray(x, dtype) for x in grid)
    time, position, weight = (x.ravel() for x in points)
    nodes = sizes.positions * sizes.fine + 1
    fine = step / sizes.fine
    at = (position[None, :] - time[None, :] * velocity[:, None] - low) / fine
    # Node −1 and node `nodes` exist to take what fades out.
    inside = (at > -1) & (at < nodes)
    at = jnp.where(inside, at, -1.0)
    lower = jnp.floor(jax.lax.stop_gradient(at))
    upper_share = at - lower
    row = jnp.arange(sizes.velocities, dtype=jnp.int32) * (nodes + 2)
    node = (lower.astype(jnp.int32) + (row + 1)[:, None]).ravel()
    vote = jnp.where(inside, jnp.broadcast_to(weight[None, :], at.shape), 0.0)
    flat = jnp.zeros(sizes.velocities * (nodes + 2), dtype)
    flat = flat.at[node].add((vote * (1 - upper_share)).ravel(), mode="promise_in_bounds")
    flat = flat.at[node + 1].add((vote * upper_share).ravel(), mode="promise_in_bounds")
    binned = flat.reshape(sizes.velocities, nodes + 2)[:, 1:-1]
    # All that matters is how many nodes lie between a node and a cell's lower edge.
    between = jnp.arange(-nodes, nodes).astype(dtype) * fine / sigma
    below = jax.scipy.special.ndtr(between)
    edge = np.arange(sizes.positions)[None, :] * sizes.fine - np.arange(nodes)[:, None] + nodes
    return binned @ (below[edge + sizes.fine] - below[edge])


def _check(points: Points, sizes: LineSizes) -> None:
    """Check shapes and static sizes."""
    check_array("points.position_m", points.position_m, shape=("K", "N"))
    for name in ("time_s", "weight"):
        check_array(f"points.{name}", getattr(points, name), shape=points.position_m.shape)
    for name, value in zip(sizes._fields, sizes, strict=True):
        check_size(f"sizes.{name}", value)
