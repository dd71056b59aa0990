"""Standard Hough transform: every detection votes along its sinusoid.

    ρ(θ) = x cos θ + y sin θ

K·N·n_θ votes. The other methods replace the traversal by pairs.
"""

from typing import NamedTuple

import jax
import jax.numpy as jnp

from jaxtrack.hough.grid import Grid, Sizes, cell_of, centre_of, check_sizes, steps
from jaxtrack.hough.peaks import (
    BLOCK,
    HoughInfo,
    Peaks,
    RowReader,
    check_extraction,
    extract_rows,
    inform,
    smooth,
)
from jaxtrack.hough.votes import interval_mass
from jaxtrack.numerics.checks import check_positive, check_scans
from jaxtrack.types import Array, Key, Lines, Scan


class StandardParams(NamedTuple):
    """Parameters of the standard Hough transform."""

    grid: Grid = Grid()
    peaks: Peaks = Peaks()


def rows(scans: Scan, grid: Grid, *, sizes: Sizes) -> RowReader:
    """Return a reader of the accumulator's rows, which votes when it is asked.

        C(i, j) = Σ w [ρ(θ_j) in cell i],   ρ(θ) = (x − o_x) cos θ + (y − o_y) sin θ

    Args:
        scans: K looks stacked.
        grid: where the cells lie.
        sizes: how many there are.

    Source: neutrosophic Hough transform (2018), equation 6.
    """
    position, weight = _detections(scans, grid)
    dtype = position.dtype
    rho_step, theta_step = steps(grid, sizes, dtype)
    # In units of cells, so that the inner loop is two products and a rounding.
    x, y = position[:, 0] / rho_step, position[:, 1] / rho_step

    def read(j: Array) -> Array:
        n_rows = j.shape[0]
        theta = (j.astype(dtype) + 0.5) * theta_step
        rho = jnp.cos(theta)[:, None] * x[None, :] + jnp.sin(theta)[:, None] * y[None, :]
        # What falls outside lands in a cell before the first or behind the last, cut off below.
        cell = jnp.clip(jnp.floor(rho + (sizes.rho / 2 + 1)), 0, sizes.rho + 1)
        row = jnp.arange(n_rows, dtype=jnp.int32)[:, None] * (sizes.rho + 2)
        weights = jnp.broadcast_to(weight[None, :], cell.shape).ravel()
        votes = jnp.zeros(n_rows * (sizes.rho + 2), dtype)
        index = (row + cell.astype(jnp.int32)).ravel()
        votes = votes.at[index].add(weights, mode="promise_in_bounds")
        return votes.reshape(n_rows, sizes.rho + 2)[:, 1:-1]

    return read


def accumulator(scans: Scan, grid: Grid, *, sizes: Sizes) -> Array:
    """Return the accumulator [n_θ, n_ρ] of all detections' sinusoids, hard votes.

    Args:
        scans: K looks stacked.
        grid: where the cells lie.
        sizes: how many there are.

    Example:
        >>> scans = Scan(jnp.zeros(1), jnp.ones(1, bool), jnp.zeros((1, 1, 2)),
        ...              jnp.ones((1, 1), bool))
        >>> print(accumulator(scans, Grid(), sizes=Sizes(rho=11, theta=3)).sum())
        3.0

    Source: neutrosophic Hough transform (2018), equation 6.
    """
    read = rows(scans, grid, sizes=sizes)
    blocks = -(-sizes.theta // BLOCK)
    index = jnp.arange(blocks * BLOCK, dtype=jnp.int32).reshape(blocks, BLOCK)
    # A block of rows stays in the cache: three times as fast as one scatter over all of them.
    return jax.lax.map(read, index).reshape(-1, sizes.rho)[: sizes.theta]


def soft_votes(
    rho_m: Array,
    theta_rad: Array,
    scans: Scan,
    grid: Grid,
    eps_rho_m: Array,
    eps_theta_rad: Array,
    *,
    sizes: Sizes,
) -> Array:
    """Return the soft accumulation in the cells that hold the queries, [C].

        Σ w [Φ((hi_i − ρ)/s) − Φ((lo_i − ρ)/s)],   s² = ε_ρ² + (dρ/dθ)² ε_θ²

    at the centre θ_j of the query's column. Tends to `accumulator` as both tolerances vanish;
    differentiable in detections, weights and tolerances.

    Args:
        rho_m: [C] queries, measured from the grid's origin.
        theta_rad: [C].
        scans: K looks stacked.
        grid: where the cells lie.
        eps_rho_m: [] tolerance along ρ, metres.
        eps_theta_rad: [] tolerance along θ, radians.
        sizes: how many cells there are.

    Example:
        >>> scans = Scan(jnp.zeros(1), jnp.ones(1, bool), jnp.zeros((1, 1, 2)),
        ...              jnp.ones((1, 1), bool))
        >>> print(soft_votes(jnp.zeros(1), jnp.ones(1), scans, Grid(), 1e-3, 1e-3,
        ...                  sizes=Sizes(rho=11, theta=3)))
        [1.]
    """
    position, weight = _detections(scans, grid)
    dtype = position.dtype
    rho_step, _ = steps(grid, sizes, dtype)
    i, j, inside = cell_of(rho_m, theta_rad, grid, sizes)
    centre, theta = centre_of(i, j, grid, sizes, dtype)
    eps_rho = check_positive("eps_rho_m", eps_rho_m, dtype)
    eps_theta = check_positive("eps_theta_rad", eps_theta_rad, dtype)

    def count(centre: Array, theta: Array) -> Array:
        cosine, sine = jnp.cos(theta), jnp.sin(theta)
        rho = cosine * position[:, 0] + sine * position[:, 1]
        slope = -sine * position[:, 0] + cosine * position[:, 1]
        sigma = jnp.sqrt(eps_rho**2 + (slope * eps_theta) ** 2)
        return (weight * interval_mass(rho - centre, rho_step, sigma)).sum()

    return jnp.where(inside, jax.vmap(count)(centre, theta), 0.0)


def estimate(
    scans: Scan, params: StandardParams, key: Key | None = None, *, sizes: Sizes
) -> tuple[Lines, HoughInfo]:
    """Return the strongest lines of the standard Hough transform.

    Args:
        scans: K looks stacked.
        params: grid and extractor.
        key: not used; part of every window estimator's signature.
        sizes: static sizes.

    Example:
        >>> scans = Scan(jnp.arange(3.0), jnp.ones(3, bool),
        ...              jnp.array([[[0.0, 8.0]], [[9.0, 8.0]], [[20.0, 8.0]]]), jnp.ones((3, 1), bool))
        >>> lines, info = estimate(scans, StandardParams(Grid(rho_max_m=50.0)),
        ...                        sizes=Sizes(lines=1, rho=100, theta=180))
        >>> print(lines.votes, info.members.sum())
        [3.] 3

    Source: neutrosophic Hough transform (2018), equation 6.

    Note:
        Loops of traced length: give the Monte Carlo engine `micro_batch=1`. Smoothed, the
        accumulator stands in memory: 20 MB at 1 600 × 3 142 cells.
    """  # noqa: E501
    check_sizes(sizes)
    scans = check_scans(scans)
    check_extraction(params.grid, params.peaks)
    read = rows(scans, params.grid, sizes=sizes)
    if sizes.smooth:
        # Smoothing needs the rows around a row: here the accumulator has to stand in memory.
        smoothed = smooth(accumulator(scans, params.grid, sizes=sizes), sizes=sizes)
        lines = extract_rows(lambda j: smoothed[j], read, params.grid, params.peaks, sizes=sizes)
    else:
        lines = extract_rows(read, read, params.grid, params.peaks, sizes=sizes)
    return lines, inform(lines, scans, params.peaks, jnp.asarray(False), None)


def _detections(scans: Scan, grid: Grid) -> tuple[Array, Array]:
    """Return positions from the grid's origin [K·N, 2] and weights, zero where nothing stands."""
    scans = check_scans(scans)
    counts = (scans.mask & scans.valid[:, None]).ravel()
    position = scans.position_m.reshape(-1, 2)
    position = position - jnp.asarray(grid.origin_m, position.dtype)[None, :]
    position = jnp.where(counts[:, None], position, 0.0)
    if scans.weight is None:
        return position, counts.astype(position.dtype)
    return position, jnp.where(counts, scans.weight.ravel(), 0.0)
