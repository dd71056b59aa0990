"""Peaks among query points, and their refinement below the cell: the end of section IV.B."""

from typing import NamedTuple

import numpy as np

from tests.oracles import lines
from tests.oracles.pairs import detections
from tests.oracles.votes import (
    cell_of,
    centre_of,
    gaussian_value,
    representations,
    smoothed_value,
)


class Peak(NamedTuple):
    """A chosen query point."""

    index: int  # of the query
    rho: float
    theta: float
    votes: float


def greedy(queries, separation_rho, separation_theta, max_lines):
    """Return at most `max_lines` peaks of queries (ρ, θ, value), strongest first: equation 32."""
    free = [True] * len(queries)
    found = []
    # What is left of the strongest by rounding alone is nothing.
    least = np.finfo(float).eps * max((value for _, _, value in queries), default=0.0)
    while len(found) < max_lines:
        best = None
        for n, (_, _, value) in enumerate(queries):
            if free[n] and value > least and (best is None or value > queries[best][2]):
                best = n
        if best is None:
            break
        rho_p, theta_p, value = queries[best]
        found.append(Peak(best, rho_p, theta_p, value))
        for n, (rho_q, theta_q, _) in enumerate(queries):
            d_rho, d_theta = lines.difference(rho_p, theta_p, rho_q, theta_q)
            if abs(d_rho) <= separation_rho and abs(d_theta) <= separation_theta:
                free[n] = False
    return found


def distinct(refined, separation_rho, separation_theta):
    """Return the refined peaks (ρ, θ, votes) that stand apart from every stronger one."""
    kept = []
    for rho, theta, votes in refined:
        merged = False
        for other_rho, other_theta, _ in kept:
            d_rho, d_theta = lines.difference(rho, theta, other_rho, other_theta)
            merged |= abs(d_rho) <= separation_rho and abs(d_theta) <= separation_theta
        if not merged:
            kept.append((rho, theta, votes))
    return kept


def cell_votes(accumulator, grid):
    """Return all cells of [n_theta, n_rho] as votes at equations 25 and 26's centres, ρ fastest."""
    found = []
    for j in range(grid.n_theta):
        for i in range(grid.n_rho):
            found.append((*centre_of(i, j, grid), float(accumulator[j][i])))
    return found


def greedy_dense(accumulator, grid, separation_rho, separation_theta, max_lines, smoothing=0):
    """Return the peaks of an accumulator [n_theta, n_rho], smoothed by cells: equation 32."""
    queries = cell_votes(accumulator, grid)
    if smoothing:
        cast = [vote for vote in queries if vote[2] != 0.0]
        queries = [
            (rho, theta, smoothed_value((rho, theta), cast, grid, smoothing))
            for rho, theta, _ in queries
        ]
    return greedy(queries, separation_rho, separation_theta, max_lines)


def refine(peak, votes, grid, radius):
    """Return (ρ, θ), the mean of the votes within `radius` cells of the peak's: section IV.B."""
    rho_p, theta_p = peak[0], peak[1]
    cell = cell_of(rho_p, theta_p, grid)
    assert cell is not None, "a peak is inside the grid"
    total, sum_rho, sum_theta = 0.0, 0.0, 0.0
    for vote in votes:
        for i, j, rho, theta in representations(vote, grid):
            if abs(i - cell[0]) <= radius and abs(j - cell[1]) <= radius:
                total += vote[2]
                sum_rho += vote[2] * rho
                sum_theta += vote[2] * theta
    if total == 0.0:
        return rho_p, theta_p
    return lines.wrap(sum_rho / total, sum_theta / total)


def refine_mean_shift(peak, votes, scale):
    """Return (ρ, θ) after a mean-shift step with equation 15; `scale` is S, or one a vote."""
    rho_p, theta_p = peak[0], peak[1]
    total = gaussian_value((rho_p, theta_p), votes, scale)
    if total == 0.0:
        return rho_p, theta_p
    sum_rho, sum_theta = 0.0, 0.0
    for vote, one in zip(votes, np.broadcast_to(scale, (len(votes), 2, 2)), strict=True):
        d_rho, d_theta = lines.difference(rho_p, theta_p, vote[0], vote[1])
        weight = gaussian_value((rho_p, theta_p), [vote], one)
        # p − Δ is the vote, or its twin, next to the peak.
        sum_rho += weight * (rho_p - d_rho)
        sum_theta += weight * (theta_p - d_theta)
    return lines.wrap(sum_rho / total, sum_theta / total)


def members(rho, theta, scan, member_m):
    """Return [K, N], the detections within `member_m` of a line from (0, 0): equation 6."""
    table = np.zeros(np.shape(scan.mask), dtype=bool)
    for k in range(len(scan.time_s)):
        for detection in detections(scan, k):
            x, y = detection.position
            off = np.cos(theta) * x + np.sin(theta) * y - rho
            table[k, detection.index] = abs(off) <= member_m
    return table
