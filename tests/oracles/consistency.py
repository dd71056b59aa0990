"""Swap and loss, normalized errors, and bounds, one number or one matrix after the other."""

import itertools

import numpy as np

from tests.oracles.kalman import range_bearing_jacobian


def swap_and_loss(estimates, truths, limit, looks):
    """Return (swap, loss) of two tracks [T, 2, D]."""
    own, crossed = np.zeros(2), np.zeros(2)
    for t in range(len(truths) - looks, len(truths)):
        for i in range(2):
            own[i] += np.linalg.norm(estimates[t, i] - truths[t, i]) / looks
            crossed[i] += np.linalg.norm(estimates[t, i] - truths[t, 1 - i]) / looks
    swap = sum(crossed) < sum(own) and max(crossed) < limit
    return swap, not swap and max(own) >= limit


def normalized(error, covariance):
    return error @ np.linalg.inv(covariance) @ error


def bound(covariance, transitions, noises, informations):
    """Return the bound by Tichavský's recursion; Q has to be invertible."""
    information = np.linalg.inv(covariance)
    found = []
    for f, q, g in zip(transitions, noises, informations, strict=True):
        inverse = np.linalg.inv(q)
        d11, d12, d22 = f.T @ inverse @ f, -f.T @ inverse, inverse + g
        information = d22 - d12.T @ np.linalg.inv(information + d11) @ d12
        found.append(np.linalg.inv(information))
    return np.array(found)


def enumeration_bound(covariance, transitions, noises, h, r, p_detect):
    """Return the mean of the Kalman filter's covariance over all sequences of detections."""
    looks = len(transitions)
    found = np.zeros((looks, *covariance.shape))
    for sequence in itertools.product((False, True), repeat=looks):
        p, weight = covariance, 1.0
        for k, seen in enumerate(sequence):
            p = transitions[k] @ p @ transitions[k].T + noises[k]
            if seen:
                p = p - p @ h.T @ np.linalg.inv(h @ p @ h.T + r) @ h @ p
            weight *= p_detect if seen else 1 - p_detect
            # What comes later multiplies the weights of this prefix to one.
            found[k] += p * weight * 0.5 ** (looks - 1 - k)
    return found


def range_bearing_information(states, mask, position, noise, p_detect):
    total, count = 0.0, 0
    for state, there, p in zip(states, mask, p_detect, strict=True):
        if there:
            h = range_bearing_jacobian(state, position)
            total, count = total + p * h.T @ np.linalg.inv(noise) @ h, count + 1
    return total / count
