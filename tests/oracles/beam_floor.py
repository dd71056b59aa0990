"""Floors for a multi-beam sonar that knows which detections are a target's: by quadrature, loops.

Ranges have Gaussian noise, bearings are uniform inside their beams.
"""

import math

import numpy as np

from tests.oracles.beam_joint import seen_from_sonar


def log_posterior(state, elapsed, poses, ranges, beams, known, sonar, count, speeds):
    """Return the log-density of a state at the window's end, up to a constant; −inf outside."""
    speed = math.hypot(state[2], state[3])
    if not speeds[0] <= speed <= speeds[1]:
        return -math.inf
    total = 0.0
    for dt, pose, range_m, beam, there in zip(elapsed, poses, ranges, beams, known, strict=True):
        x, y = state[0] + dt * state[2], state[1] + dt * state[3]
        rho, bearing = seen_from_sonar(x, y, pose, sonar.mount_m)
        if there:
            at = bearing / (sonar.sector_rad / count) + count / 2.0
            if not beam <= at <= beam + 1:
                return -math.inf
            total -= 0.5 * ((range_m - rho) / sonar.sigma_m) ** 2
    return total


def posterior_mean(log_density, centre, covariance, draws, rng):
    """Return the mean of a density, from weighted draws of a Gaussian twice as wide as it."""
    root = 2.0 * np.linalg.cholesky(covariance)
    states, values = [], []
    for z in rng.normal(size=(draws, 4)):
        states.append(np.asarray(centre) + root @ z)
        values.append(log_density(states[-1]) + 0.5 * z @ z)
    weights = np.exp(np.array(values) - max(values))
    return weights @ np.array(states) / weights.sum()


def least_squares(start, elapsed, poses, ranges, beams, known, sonar, count, steps=15):
    """Return the Gauss–Newton fit to ranges and beam centres, and the inverse of its information.

    A beam's bearing is taken as Gaussian with the variance of the beam, width²/12.
    """
    state = np.array(start, float)
    width = sonar.sector_rad / count
    for _ in range(steps):
        rows, rest = [], []
        for dt, pose, range_m, beam, there in zip(
            elapsed, poses, ranges, beams, known, strict=True
        ):
            if not there:
                continue

            def predict(s, dt=dt, pose=pose):
                x, y = s[0] + dt * s[2], s[1] + dt * s[3]
                return np.array(seen_from_sonar(x, y, pose, sonar.mount_m))

            scale = np.array([sonar.sigma_m, width / math.sqrt(12.0)])
            seen = np.array([range_m, (beam + 0.5 - count / 2.0) * width])
            slope = np.zeros((2, 4))
            for axis in range(4):
                step = 1e-5 * np.eye(4)[axis]
                slope[:, axis] = (predict(state + step) - predict(state - step)) / 2e-5
            rows.append(slope / scale[:, None])
            rest.append((seen - predict(state)) / scale)
        matrix = np.concatenate(rows)
        inverse = np.linalg.inv(matrix.T @ matrix)
        state = state + inverse @ matrix.T @ np.concatenate(rest)
    return state, inverse
