"""Votes and the kernels that count them.

A vote is a weighted point (ρ, θ). A kernel says how much of each vote counts at a query: all of it
in the same cell (`hard`), the share of its Gaussian that falls into the cell (`soft`, tends to
`hard` as the tolerances vanish), or the Gaussian itself (`gaussian`, equation 15). Votes are
evaluated where they are asked for: the dense accumulator exists for pictures.
"""

from collections.abc import Callable
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from jaxtrack.hough.grid import Grid, Sizes, cell_difference, cell_of, centre_of, steps
from jaxtrack.models.line import line_difference
from jaxtrack.numerics.checks import check_positive
from jaxtrack.numerics.safe import safe_divide
from jaxtrack.types import Array

# The screening table's size: a power of two that stays in the second-level cache.
_TABLE = 1 << 16


class Votes(NamedTuple):
    """Weighted points of the parameter space, ρ measured from the grid's origin."""

    rho_m: Array  # [Q]
    theta_rad: Array  # [Q]
    weight: Array  # [Q]
    mask: Array  # [Q]


Cells = tuple[Array, Array, Array]
"""Cell indices (i, j), or distances in cells, and what lies in the grid."""


class VoteKernel(NamedTuple):
    """How votes count at a query (ρ, θ).

    `prepare(votes)` is what the other two need of the votes, whatever the query.
    `similarity(rho, theta, prepared) -> [Q]` is how much of each vote counts; `nearby(...) -> [Q]`
    is how much each vote says about the peak's place between the cells. Farther than `reach` a
    vote counts for (next to) nothing.
    """

    prepare: Callable[[Votes], Any]
    similarity: Callable[[Array, Array, Any], Array]
    nearby: Callable[[Array, Array, Any], Array]
    reach_rho_m: Array
    reach_theta_rad: Array


def hard(grid: Grid, sizes: Sizes, dtype: jnp.dtype) -> VoteKernel:
    """Count the votes of the query's own cell, smoothed by a Gaussian of `sizes.smooth` cells.

        C(p) = Σ_q w_q [cell(q) = cell(p)]    or    C(p) = Σ_q w_q g(Δi) g(Δj)

    with g a Gaussian cut off at three sigma and normalised over the cells.

    Args:
        grid: where the cells lie.
        sizes: how many there are; `smooth` in cells.
        dtype: of the votes.

    Example:
        >>> sizes = Sizes(rho=100, theta=100)
        >>> votes = Votes(jnp.array([1.0, 2.0]), jnp.array([0.5, 0.5]), jnp.ones(2), jnp.ones(2, bool))
        >>> kernel = hard(Grid(), sizes, votes.rho_m.dtype)
        >>> print(evaluate(jnp.array([1.5]), jnp.array([0.5]), votes, kernel))
        [2.]

    Source: neutrosophic Hough transform (2018), equations 16–19 and 23.
    """  # noqa: E501
    reach = 3 * sizes.smooth
    profile = np.exp(-(np.arange(reach + 1) ** 2) / (2 * max(sizes.smooth, 1) ** 2))
    profile /= profile[0] + 2 * profile[1:].sum()

    def prepare(votes: Votes) -> Cells:
        return cell_of(votes.rho_m, votes.theta_rad, grid, sizes)

    def cells_apart(rho: Array, theta: Array, cells: Cells) -> Cells:
        i, j, inside = cell_of(rho, theta, grid, sizes)
        d_i, d_j = cell_difference(i, j, *cells[:2], sizes)
        return jnp.abs(d_i), jnp.abs(d_j), inside & cells[2]

    def similarity(rho: Array, theta: Array, cells: Cells) -> Array:
        if reach == 0:
            i, j, inside = cell_of(rho, theta, grid, sizes)
            return (inside & cells[2] & (i == cells[0]) & (j == cells[1])).astype(dtype)
        d_i, d_j, inside = cells_apart(rho, theta, cells)
        spread = jnp.asarray(2.0 * sizes.smooth**2, dtype)
        squared = (d_i * d_i + d_j * d_j).astype(dtype)
        within = inside & (d_i <= reach) & (d_j <= reach)
        return jnp.where(within, float(profile[0] ** 2) * jnp.exp(-squared / spread), 0.0)

    def nearby(rho: Array, theta: Array, cells: Cells) -> Array:
        d_i, d_j, inside = cells_apart(rho, theta, cells)
        return (inside & (d_i <= max(reach, 1)) & (d_j <= max(reach, 1))).astype(dtype)

    rho_step, theta_step = steps(grid, sizes, dtype)
    return VoteKernel(prepare, similarity, nearby, (reach + 1) * rho_step, (reach + 1) * theta_step)


def soft(
    grid: Grid, sizes: Sizes, eps_rho_m: Array, eps_theta_rad: Array, dtype: jnp.dtype
) -> VoteKernel:
    """Count the share of each vote's Gaussian that falls into the query's cell.

        C(p) = Σ_q w_q ∏_{x ∈ (ρ, θ)} [Φ((hi_x − x_q)/ε_x) − Φ((lo_x − x_q)/ε_x)]

    Differentiable in the votes and the tolerances; tends to the raw `hard` (`sizes.smooth` 0) as
    both tolerances vanish.

    Args:
        grid: where the cells lie.
        sizes: how many there are; `smooth` is not used.
        eps_rho_m: [] standard deviation of a vote along ρ, metres.
        eps_theta_rad: [] along θ, radians.
        dtype: of the votes.

    Example:
        >>> sizes = Sizes(rho=100, theta=100)
        >>> votes = Votes(jnp.array([40.0]), jnp.array([0.5]), jnp.ones(1), jnp.ones(1, bool))
        >>> kernel = soft(Grid(), sizes, jnp.array(40.0), jnp.array(1e-4), votes.rho_m.dtype)
        >>> print(f"{evaluate(jnp.array([1.5]), jnp.array([0.5]), votes, kernel)[0]:.3f}")
        0.683
    """
    rho_step, theta_step = steps(grid, sizes, dtype)

    def block_mass(rho: Array, theta: Array, votes: Votes, cells: float) -> Array:
        i, j, inside = cell_of(rho, theta, grid, sizes)
        centre = centre_of(i, j, grid, sizes, dtype)
        d_rho, d_theta = line_difference(*centre, votes.rho_m, votes.theta_rad)
        mass = interval_mass(d_rho, cells * rho_step, eps_rho_m)
        mass = mass * interval_mass(d_theta, cells * theta_step, eps_theta_rad)
        return jnp.where(inside, mass, 0.0)

    similarity: Callable[..., Array] = lambda *at: block_mass(*at, cells=1.0)
    nearby: Callable[..., Array] = lambda *at: block_mass(*at, cells=3.0)
    reach = rho_step + 3 * eps_rho_m, theta_step + 3 * eps_theta_rad
    return VoteKernel(_as_they_are, similarity, nearby, *reach)


def gaussian(eps_rho_m: Array, eps_theta_rad: Array) -> VoteKernel:
    """Count each vote by the Gaussian membership of its distance from the query.

        C(p) = Σ_q w_q exp(−Δρ²/2ε_ρ² − Δθ²/2ε_θ²)

    Args:
        eps_rho_m: [] tolerance along ρ, metres.
        eps_theta_rad: [] along θ, radians.

    Example:
        >>> votes = Votes(jnp.array([40.0]), jnp.array([0.5]), jnp.ones(1), jnp.ones(1, bool))
        >>> kernel = gaussian(jnp.array(40.0), jnp.array(0.1))
        >>> print(f"{evaluate(jnp.array([0.0]), jnp.array([0.5]), votes, kernel)[0]:.3f}")
        0.607

    Raises:
        ValueError: a known tolerance that is not a positive, finite number.

    Source: neutrosophic Hough transform (2018), equations 15 and 31.
    """
    for name, eps in (("eps_rho_m", eps_rho_m), ("eps_theta_rad", eps_theta_rad)):
        check_positive(name, eps, jnp.result_type(float))

    def similarity(rho: Array, theta: Array, votes: Votes) -> Array:
        d_rho, d_theta = line_difference(rho, theta, votes.rho_m, votes.theta_rad)
        return _gaussian(d_rho, eps_rho_m, d_theta, eps_theta_rad)

    return VoteKernel(_as_they_are, similarity, similarity, 3 * eps_rho_m, 3 * eps_theta_rad)


def scaled_gaussian(scale: Array, mask: Array) -> VoteKernel:
    """Count each vote by a Gaussian of its own covariance.

        C(p) = Σ_q w_q exp(−½ Δᵀ S_q⁻¹ Δ)

    Args:
        scale: [Q, 3] var ρ, cov(ρ, θ) and var θ of every vote, as `models.line_covariance` gives.
        mask: [Q] which votes exist.
    """
    # Free slots get a unit scale, so that nothing is divided by zero.
    unit = jnp.asarray([1.0, 0.0, 1.0], scale.dtype)
    scale = jnp.where(mask[:, None], scale, unit[None, :])
    typical = lambda variance: jnp.sqrt(
        jnp.where(mask, variance, 0.0).sum() / jnp.maximum(mask.sum(), 1).astype(scale.dtype)
    )

    def similarity(rho: Array, theta: Array, votes: Votes) -> Array:
        # Differences are taken from the vote, in whose name of the line its covariance holds.
        d_rho, d_theta = line_difference(votes.rho_m, votes.theta_rad, rho, theta)
        return correlated_gaussian(d_rho, d_theta, scale)

    reach = [
        3 * jax.lax.stop_gradient(typical(variance)) for variance in (scale[:, 0], scale[:, 2])
    ]
    tiny = jnp.asarray(jnp.finfo(scale.dtype).eps, scale.dtype)
    return VoteKernel(_as_they_are, similarity, similarity, *(x + tiny for x in reach))


def correlated_gaussian(d_rho: Array, d_theta: Array, scale: Array) -> Array:
    """Return exp(−½ Δᵀ S⁻¹ Δ) for S = var ρ, cov and var θ along the last axis.

    As a sum of two squares, Δθ²/var θ + (Δρ − β Δθ)²/(var ρ − β cov) with β = cov/var θ: far from
    the origin ρ and θ are almost one, and a determinant would lose its digits, and its sign.
    """
    var_rho, cov, var_theta = (scale[..., c] for c in range(3))
    slope = safe_divide(cov, var_theta)
    rest = var_rho - slope * cov
    least = 4 * jnp.finfo(scale.dtype).eps * var_rho
    rest = jnp.where(rest > least, rest, least)
    squared = safe_divide(d_theta**2, var_theta)
    return jnp.exp(-(squared + safe_divide((d_rho - slope * d_theta) ** 2, rest)) / 2)


def evaluate(rho_m: Array, theta_rad: Array, votes: Votes, kernel: VoteKernel) -> Array:
    """Return the value of the accumulation at queries [C]: Σ_q w_q · similarity."""
    clean = _clean(votes)
    prepared = kernel.prepare(clean)

    def count(at: tuple[Array, Array]) -> Array:
        rho, theta = at
        return (clean.weight * kernel.similarity(rho, theta, prepared)).sum()

    # A loop, for its operands stand in memory: in one product of queries and votes XLA computes
    # every vote anew, pairs and all, for every query. Gradients do not fetch what they can compute.
    return jax.lax.map(jax.checkpoint(count, prevent_cse=False), (rho_m, theta_rad))


def accumulate(votes: Votes, grid: Grid, *, sizes: Sizes) -> Array:
    """Return the dense hard accumulator [n_θ, n_ρ]: for pictures, and for counting cells.

    Example:
        >>> votes = Votes(jnp.array([1.0, 2.0]), jnp.array([0.5, 0.5]), jnp.ones(2), jnp.ones(2, bool))
        >>> print(accumulate(votes, Grid(), sizes=Sizes(rho=100, theta=100)).max())
        2.0
    """  # noqa: E501
    clean = _clean(votes)
    i, j, inside = cell_of(clean.rho_m, clean.theta_rad, grid, sizes)
    cell = jnp.where(inside, j * sizes.rho + i, sizes.rho * sizes.theta)
    flat = jnp.zeros(sizes.rho * sizes.theta, clean.weight.dtype)
    return flat.at[cell].add(clean.weight, mode="drop").reshape(sizes.theta, sizes.rho)


def upper_bound(rho_m: Array, theta_rad: Array, votes: Votes, kernel: VoteKernel) -> Array:
    """Return a cheap upper bound on the accumulation at queries [C], to rank them by.

    The space is cut into blocks of the kernel's reach; the weights are added up a block in a hash
    table (a collision only raises the bound), and a query reads its own block and the eight around
    it. Cost: one scatter a vote and nine gathers a query, instead of votes × queries.
    """
    clean = _clean(votes)
    dtype = clean.rho_m.dtype
    half_turn = jnp.asarray(jnp.pi, dtype)
    rows = jnp.clip(jnp.floor(half_turn / kernel.reach_theta_rad), 1, 1 << 14)

    def block(rho: Array, theta: Array) -> tuple[Array, Array]:
        column = jnp.clip(jnp.floor(rho / kernel.reach_rho_m), -(1 << 24), 1 << 24)
        row = jnp.minimum(jnp.floor(theta * (rows / half_turn)), rows - 1)
        return column.astype(jnp.int32), row.astype(jnp.int32)

    def slot(column: Array, row: Array) -> Array:
        return (row * 40503 + column) & (_TABLE - 1)

    weights = jnp.zeros(_TABLE, dtype).at[slot(*block(clean.rho_m, clean.theta_rad))]
    table = weights.add(clean.weight)
    column, row = block(rho_m, theta_rad)
    last = rows.astype(jnp.int32)
    total = jnp.zeros_like(rho_m)
    for d_row in (-1, 0, 1):
        turned = (row + d_row < 0) | (row + d_row >= last)
        other_row = jnp.where(turned, row + d_row - jnp.sign(d_row) * last, row + d_row)
        for d_column in (-1, 0, 1):
            other = jnp.where(turned, -1 - column - d_column, column + d_column)
            total = total + table[slot(other, other_row)]
    return total


def interval_mass(distance: Array, width: Array, sigma: Array) -> Array:
    """Return the mass of N(0, σ²) in an interval of a width whose centre is `distance` away."""
    distance = jnp.abs(distance)  # the lower tail keeps its relative precision
    high = jax.scipy.special.ndtr((width / 2 - distance) / sigma)
    return high - jax.scipy.special.ndtr((-width / 2 - distance) / sigma)


def _gaussian(d_rho: Array, eps_rho: Array, d_theta: Array, eps_theta: Array) -> Array:
    return jnp.exp(-((d_rho / eps_rho) ** 2 + (d_theta / eps_theta) ** 2) / 2)


def _as_they_are(votes: Votes) -> Votes:
    return votes


def _clean(votes: Votes) -> Votes:
    """Put harmless numbers where no vote stands, so that neither value nor gradient sees them."""
    keep = lambda x: jnp.where(votes.mask, x, 0.0)
    return Votes(keep(votes.rho_m), keep(votes.theta_rad), keep(votes.weight), votes.mask)
