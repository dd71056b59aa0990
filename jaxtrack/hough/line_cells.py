"""Cells of a slope–intercept vote: those above a threshold, and the centroid of one line's."""

from typing import NamedTuple

import jax
import jax.numpy as jnp

from jaxtrack.hough.slope_intercept import LineGrid, LineSizes, cell_centres
from jaxtrack.numerics.safe import safe_divide
from jaxtrack.types import Array

_LEAST = 1e-30  # votes; a line of fewer is none: its gradient is beyond single precision


class Cells(NamedTuple):
    """The cells of a vote matrix that pass the primary threshold, strongest first."""

    velocity_m_s: Array  # [C]
    position_m: Array  # [C]
    votes: Array  # [C]
    mask: Array  # [C]
    overflow: Array  # [] more cells passed than there are places


def cells_above(
    votes: Array,
    share: Array | float,
    grid: LineGrid,
    *,
    cells: int,
    sizes: LineSizes,
    temperature: Array | None = None,
) -> Cells:
    """Return the cells with more votes than a share of the strongest one's.

        v'_ij = v_ij where v_ij > λ, else 0,     λ = share · max v

    Args:
        votes: [V, P].
        share: λ over the peak, below 1.
        grid: where the cells lie.
        cells: how many there is place for.
        sizes: V and P.
        temperature: None for the threshold; else votes are weighted by a sigmoid of its width, as
            a share of the peak.

    Example:
        >>> votes = jnp.array([[0.0, 9.0, 3.0], [4.0, 0.0, 1.0]])
        >>> found = cells_above(votes, 0.4, LineGrid(-1.0, 2.0, 0.0, 4.0), cells=3,
        ...                     sizes=LineSizes(velocities=2, positions=3))
        >>> print(found.velocity_m_s, found.position_m, found.votes)
        [-1.  1.  0.] [6. 2. 0.] [9. 4. 0.]

    Source: clustering-statistic Hough transform (2018), equations 17–20.

    Note:
        Equation 19 copies a cell as often as it has votes; weights say the same in a fixed shape.
    """
    dtype = votes.dtype
    share = jnp.asarray(share, dtype)
    best, at = jax.lax.top_k(votes.ravel(), min(cells + 1, votes.size))
    peak = best[0]
    last = best[-1]
    best, at = best[:cells], at[:cells]
    if temperature is None:
        above = best > share * peak
        weight = best
        crowded = last > share * peak
    else:
        width = jnp.asarray(temperature, dtype)
        above = best > 0
        weight = best * jax.nn.sigmoid((safe_divide(best, peak) - share) / width)
        crowded = last > (share + 4 * width) * peak
    velocity, position = cell_centres(grid, sizes=sizes, dtype=dtype)
    row, column = at // sizes.positions, at % sizes.positions
    clear = lambda x: jnp.where(above, x, 0.0)
    overflow = crowded & (votes.size > cells)
    return Cells(clear(velocity[row]), clear(position[column]), clear(weight), above, overflow)


def single_line(
    votes: Array,
    share: Array | float,
    grid: LineGrid,
    *,
    sizes: LineSizes,
    temperature: Array | None = None,
) -> Array:
    """Return velocity and initial position of the one line in a vote matrix, [2].

    It is the centroid of the cells with more than a share of the peak's votes: one cluster.

    Args:
        votes: [V, P].
        share: of the peak, below 1.
        grid: where the cells lie.
        sizes: V and P.
        temperature: as in `cells_above`.

    Example:
        >>> votes = jnp.array([[0.0, 9.0], [9.0, 1.0]])
        >>> print(single_line(votes, 0.5, LineGrid(-1.0, 2.0, 0.0, 4.0),
        ...                   sizes=LineSizes(velocities=2, positions=2)))
        [0. 4.]
    """
    share = jnp.asarray(share, votes.dtype)
    if temperature is None:
        peak = jax.lax.stop_gradient(votes).max()
        weight = jnp.where(votes > share * peak, votes, 0.0)
    else:
        peak = jax.lax.top_k(votes.ravel(), 1)[0][0]
        votes = jnp.where(peak > _LEAST, votes, 0.0)
        weight = votes * jax.nn.sigmoid((safe_divide(votes, peak) - share) / temperature)
    return _centroid(weight, grid, sizes)


def _centroid(weight: Array, grid: LineGrid, sizes: LineSizes) -> Array:
    """Return the mean (v, n0) of weighted cells [V, P]; zeros without any weight."""
    velocity, position = cell_centres(grid, sizes=sizes, dtype=weight.dtype)
    rows, columns = weight.sum(1), weight.sum(0)
    total = rows.sum()
    mean = jnp.stack([(rows * velocity).sum(), (columns * position).sum()])
    return safe_divide(mean, total[None])
