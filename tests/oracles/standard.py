"""The standard Hough transform: every detection votes once in every column of θ, equation 6."""

import math

import numpy as np

from tests.oracles.pairs import detections
from tests.oracles.votes import Grid, cell_of, centre_of, interval_mass, steps


def accumulator(scan, origin, rho_max, n_rho, n_theta):
    """Return the counts [n_theta, n_rho] of ρ(θ_j) at the columns' centres: equations 6 and 26."""
    grid = Grid(rho_max, n_rho, n_theta)
    table = np.zeros((n_theta, n_rho))
    for k in range(len(scan.time_s)):
        for detection in detections(scan, k):
            x, y = detection.position - np.asarray(origin, dtype=np.float64)
            for j in range(n_theta):
                theta = centre_of(0, j, grid)[1]
                cell = cell_of(x * math.cos(theta) + y * math.sin(theta), theta, grid)
                if cell is not None:
                    table[j, cell[0]] += detection.weight
    return table


def soft_cell(scan, origin, rho_max, n_rho, n_theta, i, j, eps_rho, eps_theta):
    """Return the soft count of cell (i, j): ρ(θ_j) of equation 6 blurred by ε_ρ and ρ'(θ_j) ε_θ."""
    grid = Grid(rho_max, n_rho, n_theta)
    centre, theta = centre_of(i, j, grid)
    half = steps(grid)[0] / 2.0
    total = 0.0
    for k in range(len(scan.time_s)):
        for detection in detections(scan, k):
            x, y = detection.position - np.asarray(origin, dtype=np.float64)
            rho = x * math.cos(theta) + y * math.sin(theta)
            slope = -x * math.sin(theta) + y * math.cos(theta)
            deviation = math.sqrt(eps_rho**2 + slope**2 * eps_theta**2)
            total += detection.weight * interval_mass(centre - half, centre + half, rho, deviation)
    return total
