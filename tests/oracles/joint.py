"""The joint space–time vote: how much all looks speak for one constant-velocity trajectory.

The paper has no such vote; position, velocity and clutter are those of its equations 33 and 34.
"""

import math
from typing import NamedTuple

import numpy as np

from tests.oracles.pairs import detections


class Hypothesis(NamedTuple):
    """A trajectory through detection i of look k_first and detection j of look k_second."""

    score: float
    state: np.ndarray  # [4] x, y, vx, vy
    time: float  # of the state: that of the first detection
    k_first: int
    i: int
    k_second: int
    j: int


def moved(state, elapsed):
    """Return the state [x, y, vx, vy] after `elapsed` seconds of constant velocity: equation 33."""
    x, y, v_x, v_y = (float(value) for value in state)
    return np.array([x + elapsed * v_x, y + elapsed * v_y, v_x, v_y])


def normal_density(z, mean, covariance):
    """Return N(z; mean, covariance) of the plane, the measurement of equation 34."""
    (r_xx, r_xy), (r_yx, r_yy) = (tuple(float(value) for value in row) for row in covariance)
    determinant = r_xx * r_yy - r_xy * r_yx
    d_x, d_y = float(z[0] - mean[0]), float(z[1] - mean[1])
    squared = (r_yy * d_x**2 - (r_xy + r_yx) * d_x * d_y + r_xx * d_y**2) / determinant
    return math.exp(-0.5 * squared) / (2.0 * math.pi * math.sqrt(determinant))


def log_likelihood_ratio(state, scan, k, p_detect, clutter_density, sigma):
    """Return log(1 − P_D + (P_D/λ) Σ w N(z; Hx(t), R)) of look k, with equation 34's H.

    The state is at the look's time; each detection is compared with it at its own time.
    """
    if not bool(scan.valid[k]):
        return 0.0
    total = 0.0
    for detection in detections(scan, k):
        there = moved(state, detection.time - float(scan.time_s[k]))
        if scan.covariance_m2 is None:
            covariance = sigma**2 * np.eye(2)
        else:
            covariance = scan.covariance_m2[k][detection.index]
        total += detection.weight * normal_density(detection.position, there[:2], covariance)
    return math.log(1.0 - p_detect + p_detect / clutter_density * total)


def score(state, t_state, scan, p_detect, clutter_density, sigma):
    """Return a trajectory's log-likelihood ratio summed over all looks: equations 33 and 34."""
    total = 0.0
    for k in range(len(scan.time_s)):
        there = moved(state, float(scan.time_s[k]) - t_state)
        total += log_likelihood_ratio(there, scan, k, p_detect, clutter_density, sigma)
    return total


def best_pair_hypothesis(scan, p_detect, clutter_density, sigma, v_min, v_max, min_gap):
    """Return the best `Hypothesis` of all pairs within equation 20's speeds, None without any.

    The pairs are `min_gap` looks or more apart and are tried in the order of first look, second
    look, second detection, first detection; the first wins a tie.
    """
    best = None
    for k_first in range(len(scan.time_s)):
        for k_second in range(k_first + min_gap, len(scan.time_s)):
            for b in detections(scan, k_second):
                for a in detections(scan, k_first):
                    elapsed = b.time - a.time
                    if elapsed <= 0.0:
                        continue
                    velocity = (b.position - a.position) / elapsed
                    if not v_min <= math.hypot(*velocity) <= v_max:
                        continue
                    state = np.concatenate([a.position, velocity])
                    value = score(state, a.time, scan, p_detect, clutter_density, sigma)
                    if best is None or value > best.score:
                        best = Hypothesis(value, state, a.time, k_first, a.index, k_second, b.index)
    return best
