"""Gating, nearest neighbours, PDA and Kalman updates, pair by pair, from their definitions.

Tracks are a list of (ẑ, H P Hᵀ), None for an empty slot; detections of (z, R, weight), None for
one that is none. Associations are lists of dicts: a track's detections and their weights.
"""

import itertools
import math

import numpy as np


def squared_distance(track, detection):
    """Return vᵀ S⁻¹ v."""
    v = np.asarray(detection[0], float) - np.asarray(track[0], float)
    return float(v @ np.linalg.inv(np.asarray(track[1]) + np.asarray(detection[1])) @ v)


def gated(tracks, detections, gate):
    """Return {(j, i): d²} of the pairs inside the gate."""
    return {
        (j, i): squared_distance(track, detection)
        for j, track in enumerate(tracks)
        for i, detection in enumerate(detections)
        if track is not None
        and detection is not None
        and detection[2] > 0
        and squared_distance(track, detection) < gate
    }


def density(track, detection):
    """Return N(z; ẑ, S)."""
    s = np.asarray(track[1]) + np.asarray(detection[1])
    d2 = squared_distance(track, detection)
    return math.exp(-d2 / 2) / math.sqrt(np.linalg.det(2 * math.pi * s))


def ratios(tracks, detections, p_detect, clutter, gate):
    """Return w [T][M] and w_0 [T]."""
    w = np.zeros((len(tracks), len(detections)))
    for j, i in gated(tracks, detections, gate):
        w[j, i] = p_detect * detections[i][2] * density(tracks[j], detections[i]) / clutter
    in_gate = 1 - math.exp(-gate / 2)
    return w, [1.0 if track is None else 1 - p_detect * in_gate for track in tracks]


def independent(tracks, detections, gate):
    """Return what each track takes: its nearest."""
    pairs = gated(tracks, detections, gate)
    taken = []
    for j in range(len(tracks)):
        mine = [(d, i) for (k, i), d in pairs.items() if k == j]
        taken.append({min(mine)[1]: 1.0} if mine else {})
    return taken


def greedy(tracks, detections, gate):
    """Return what each track takes if the closest pair always comes first."""
    taken, used = [{} for _ in tracks], set()
    for d, j, i in sorted((d, j, i) for (j, i), d in gated(tracks, detections, gate).items()):
        if not taken[j] and i not in used:
            taken[j][i] = 1.0
            used.add(i)
        assert d >= 0
    return taken


def total_cost(taken, tracks, detections, gate):
    """Return Σ d² + γ for each track without a detection."""
    pairs = gated(tracks, detections, gate)
    cost = 0.0
    for j, track in enumerate(tracks):
        if track is not None:
            cost += sum(pairs[j, i] for i in taken[j]) if taken[j] else gate
    return cost


def events(tracks, detections, gate):
    """Yield all ways to give each track one detection in its gate or none, none to two tracks."""
    pairs = gated(tracks, detections, gate)
    choices = [
        [None] + [i for i in range(len(detections)) if (j, i) in pairs] for j in range(len(tracks))
    ]
    for event in itertools.product(*choices):
        used = [i for i in event if i is not None]
        if len(used) == len(set(used)):
            yield [{} if i is None else {i: 1.0} for i in event]


def optimal(tracks, detections, gate):
    """Return the cheapest of all ways."""
    return min(
        events(tracks, detections, gate),
        key=lambda taken: total_cost(taken, tracks, detections, gate),
    )


def pda(w, missed):
    """Return marginals [T][M + 1], track by track."""
    rows = [[*row, w0] for row, w0 in zip(w, missed, strict=True)]
    return np.array([[x / sum(row) for x in row] for row in rows])


def kalman(mean, covariance, z, noise):
    """Return the Kalman update of a state with a position z: equations 8 and 13 to 15, minus."""
    h = np.eye(2, len(mean))
    s = h @ covariance @ h.T + noise
    gain = covariance @ h.T @ np.linalg.inv(s)
    return mean + gain @ (z - h @ mean), covariance - gain @ h @ covariance


def mixture(mean, covariance, detections, weights, miss):
    """Return the moments of the mixture of all updates, weights {i: β_i}."""
    parts = [(miss, mean, covariance)]
    for i, beta in weights.items():
        parts.append((beta, *kalman(mean, covariance, detections[i][0], detections[i][1])))
    centre = sum(beta * x for beta, x, _ in parts)
    total = sum(beta * (p + np.outer(x - centre, x - centre)) for beta, x, p in parts)
    return centre, total


def centroid(mean, covariance, detections, weights, miss, noise):
    """Return the update with the centroid of several echoes."""
    count = sum(weights.values())
    if count == 0:
        return mean, covariance
    z = sum(w * np.asarray(detections[i][0]) for i, w in weights.items()) / count
    r = sum(w * np.asarray(detections[i][1]) for i, w in weights.items()) / count
    if noise == "single":
        return mixture(mean, covariance, [(z, r, 1.0)], {0: 1 - miss}, miss)
    r = r / count
    for i, w in weights.items():
        apart = np.asarray(detections[i][0]) - z
        r = r + w * (1 - w) * np.outer(apart, apart) / count**2
    return kalman(mean, covariance, z, r)
