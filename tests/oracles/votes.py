"""What votes (ρ, θ, weight) are worth at a query point: equations 15, 23, 25, 26 and 31."""

import functools
import math
from typing import NamedTuple

import numpy as np

from tests.oracles import lines


class Grid(NamedTuple):
    """Cells over [−ρ_max, ρ_max) × [0, π)."""

    rho_max: float
    n_rho: int
    n_theta: int


def steps(grid):
    """Return (Δρ, Δθ) of the grid: below equation 26, with the signed axis of ρ."""
    return 2.0 * grid.rho_max / grid.n_rho, math.pi / grid.n_theta


def cell_of(rho, theta, grid):
    """Return the cell (i, j) of (ρ, θ), None outside the grid: equations 25 and 26 inverted."""
    d_rho, d_theta = steps(grid)
    i = math.floor((rho + grid.rho_max) / d_rho)
    j = math.floor(theta / d_theta)
    inside = 0 <= i < grid.n_rho and 0 <= j < grid.n_theta
    return (i, j) if inside else None


def centre_of(i, j, grid):
    """Return (ρ, θ) of a cell's centre: equations 25 and 26."""
    d_rho, d_theta = steps(grid)
    return (i + 0.5) * d_rho - grid.rho_max, (j + 0.5) * d_theta


def representations(vote, grid):
    """Return a vote's (i, j, ρ, θ): as it stands and as its twin on either side; [] outside."""
    rho, theta = vote[0], vote[1]
    cell = cell_of(rho, theta, grid)
    if cell is None:
        return []
    i, j = cell
    twin = grid.n_rho - 1 - i
    return [
        (i, j, rho, theta),
        (twin, j + grid.n_theta, -rho, theta + math.pi),
        (twin, j - grid.n_theta, -rho, theta - math.pi),
    ]


def hard_value(query, votes, grid):
    """Return the sum of the weights in the query's cell: equations 23 and 31, binary votes."""
    cell = cell_of(query[0], query[1], grid)
    total = 0.0
    for rho, theta, weight in votes:
        if cell is not None and cell_of(rho, theta, grid) == cell:
            total += weight
    return total


@functools.cache
def cell_kernel(k, s):
    """Return g(k), a Gaussian of s cells cut at 3 s cells that sums to 1."""
    if abs(k) > 3 * s:
        return 0.0
    norm = sum(math.exp(-(m**2) / (2.0 * s**2)) for m in range(-3 * s, 3 * s + 1))
    return math.exp(-(k**2) / (2.0 * s**2)) / norm


def smoothed_value(query, votes, grid, s):
    """Return the hard votes of equation 31 smoothed by g of s cells, across the seam too."""
    cell = cell_of(query[0], query[1], grid)
    if cell is None:
        return 0.0
    total = 0.0
    for vote in votes:
        for i, j, _, _ in representations(vote, grid):
            total += vote[2] * cell_kernel(i - cell[0], s) * cell_kernel(j - cell[1], s)
    return total


def phi(x):
    """Return the standard normal distribution function, without cancellation in the lower tail."""
    return 0.5 * math.erfc(-x / math.sqrt(2.0))


def interval_mass(low, high, mean, deviation):
    """Return the mass of a Gaussian between low and high."""
    return phi((high - mean) / deviation) - phi((low - mean) / deviation)


def soft_value(query, votes, grid, eps_rho, eps_theta):
    """Return the mass of the votes' Gaussians (equation 15) in the query's cell; 0 outside."""
    cell = cell_of(query[0], query[1], grid)
    if cell is None:
        return 0.0
    rho_c, theta_c = centre_of(cell[0], cell[1], grid)
    half_rho, half_theta = (step / 2.0 for step in steps(grid))
    total = 0.0
    for rho, theta, weight in votes:
        away_rho, away_theta = lines.difference(rho_c, theta_c, rho, theta)
        # In coordinates from the cell's centre the vote, or its twin, is at −away.
        total += (
            weight
            * interval_mass(-half_rho, half_rho, -away_rho, eps_rho)
            * interval_mass(-half_theta, half_theta, -away_theta, eps_theta)
        )
    return total


def gaussian_value(query, votes, scale):
    """Return Σ w exp(−½ Δᵀ S⁻¹ Δ): equation 15; `scale` is S [2, 2], or one for each vote.

    Δ is taken from the vote, in whose representation its S holds.
    """
    scales = np.broadcast_to(scale, (len(votes), 2, 2))
    total = 0.0
    for (rho, theta, weight), one in zip(votes, scales, strict=True):
        d_rho, d_theta = lines.difference(rho, theta, query[0], query[1])
        total += weight * lines.gaussian(d_rho, d_theta, one)
    return total


def dense(votes, grid):
    """Return the accumulator [n_theta, n_rho] of hard votes: equation 31."""
    table = np.zeros((grid.n_theta, grid.n_rho))
    for rho, theta, weight in votes:
        cell = cell_of(rho, theta, grid)
        if cell is not None:
            table[cell[1], cell[0]] += weight
    return table
