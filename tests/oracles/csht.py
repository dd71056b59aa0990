"""The clustering-statistic Hough transform, vote by vote: equations 6–19 and 38–41.

Detections are tuples (time, n, e, weight), times from the first look of the window. A grid is
(v_min, n_v, h_v, n0_min, n_n0, h_n0); cell (i, j) holds the votes of v_i = v_min + i h_v with
n0 in [n0_min + j h_n0, n0_min + (j + 1) h_n0), and stands for the middle of that interval.
"""

import math

import numpy as np

from tests.oracles import fuzzy


def hard_votes(points, grid):
    """Return V [N_v, N_n0] of points (t, n, weight): equations 7 and 13–16, in the grid."""
    v_min, n_v, h_v, low, n_n0, h = grid
    votes = np.zeros((n_v, n_n0))
    for t, n, weight in points:
        for i in range(n_v):
            r = -t * (v_min + i * h_v) + n
            j = math.floor((r - low) / h)
            if 0 <= j < n_n0:
                votes[i, j] += weight
    return votes


def direct_shares(points, grid, sigma):
    """Return Σ w [Φ((upper edge − r)/σ) − Φ((lower edge − r)/σ)] in all cells, r = n − t v.

    Votes outside the grid are dropped.
    """
    v_min, n_v, h_v, low, n_n0, h = grid
    phi = lambda z: 0.5 * (1.0 + math.erf(z / math.sqrt(2.0)))
    votes = np.zeros((n_v, n_n0))
    for t, n, weight in points:
        for i in range(n_v):
            r = n - t * (v_min + i * h_v)
            if not low <= r <= low + n_n0 * h:
                continue
            for j in range(n_n0):
                edge = low + j * h
                votes[i, j] += weight * (phi((edge + h - r) / sigma) - phi((edge - r) / sigma))
    return votes


def cells_above(votes, share, grid):
    """Return the cells (v, n0, votes) with more than a share of the peak, strongest first."""
    v_min, n_v, h_v, low, n_n0, h = grid
    peak = votes.max()
    cells = [
        (-votes[i, j], i * n_n0 + j, v_min + i * h_v, low + (j + 0.5) * h)
        for i in range(n_v)
        for j in range(n_n0)
        if peak > 0.0 and votes[i, j] > share * peak
    ]
    return [(v, n0, -negative) for negative, _, v, n0 in sorted(cells)]


def farthest_first(samples, weights, clusters):
    """Return the heaviest sample, then always the one with the largest w · d² to those taken."""
    if not samples:
        return [None] * clusters
    taken = [max(range(len(samples)), key=lambda k: (weights[k], -k))]
    while len(taken) < clusters:
        score = [
            weights[k] * min(fuzzy.squared_distance(samples[k], samples[c]) for c in taken)
            for k in range(len(samples))
        ]
        best = max(range(len(samples)), key=lambda k: (score[k], -k))
        if score[best] <= 0.0:
            break
        taken.append(best)
    return [np.array(samples[c], float) for c in taken] + [None] * (clusters - len(taken))


def single_line(points, share, grid):
    """Return (v, n0) of one line: the centroid of the cells above a share of the peak."""
    cells = cells_above(hard_votes(points, grid), share, grid)
    if not cells:
        return 0.0, 0.0
    total = sum(c[2] for c in cells)
    return sum(c[0] * c[2] for c in cells) / total, sum(c[1] * c[2] for c in cells) / total


def csht(detections, p, grid_n, grid_e, *, slots, rounds, updates, iterations):
    """Return [(n0, e0, v_n, v_e)] of the targets, in the order of the slots: algorithm 1."""
    votes = hard_votes([(t, n, w) for t, n, _, w in detections], grid_n)
    cells = cells_above(votes, p["lambda"], grid_n)
    samples = [(p["v_scale"] * v, n0 + p["tau"] * v) for v, n0, _ in cells]
    weights = [c[2] for c in cells]
    start = farthest_first(samples, weights, p["k0"]) + [None] * (slots - p["k0"])
    centres = fuzzy.isodata(
        samples, weights, start, p, rounds=rounds, updates=updates, iterations=iterations
    )
    found = [(z[0] / p["v_scale"], z[1]) for z in centres if z is not None]
    lines = [(v, n_tau - p["tau"] * v) for v, n_tau in found]
    groups = [[] for _ in lines]
    for t, n, e, w in detections:
        if lines:
            misses = [abs(n - (n0 + v * t)) for v, n0 in lines]
            groups[misses.index(min(misses))].append((t, e, w))
    targets = []
    for (v_n, n0), group in zip(lines, groups, strict=True):
        if not group:
            continue
        v_e, e0 = single_line(group, p["lambda_line"], grid_e)
        targets.append((n0, e0, v_n, v_e))
    return targets
