"""Losses of tuning, loop by loop: entropic transport in plain numbers, candidates, gates."""

import math

import numpy as np


def sinkhorn_ospa(estimates, truths, cutoff, order, temperature):
    """Return the minimum of the smoothed OSPA: a missing member costs c^p, and all is a mean."""
    size = max(len(estimates), len(truths), 1)
    total = entropic(estimates, truths, cutoff, order, temperature, missing=1.0)
    return cutoff * (total / size) ** (1 / order)


def sinkhorn_gospa(estimates, truths, cutoff, order, temperature):
    """Return the minimum of the smoothed GOSPA: a missing member costs c^p / 2, all is a sum."""
    total = entropic(estimates, truths, cutoff, order, temperature, missing=0.5)
    return cutoff * total ** (1 / order)


def entropic(estimates, truths, cutoff, order, temperature, missing, rounds=20000):
    """Return the least cost, in units of c^p, by scaling rows and columns in plain numbers."""
    m, n = len(estimates), len(truths)
    size = max(m, n)
    if size == 0:
        return 0.0
    cost = np.full((size, size), missing)  # a stand-in for every missing member
    for i in range(m):
        for j in range(n):
            distance = float(np.linalg.norm(np.asarray(estimates[i]) - np.asarray(truths[j])))
            cost[i, j] = (min(distance, cutoff) / cutoff) ** order
    kernel = np.exp(-cost / temperature) / size
    u, v = np.ones(size), np.ones(size)
    for _ in range(rounds):
        u = 1.0 / (kernel @ v)
        v = 1.0 / (kernel.T @ u)
    plan = u[:, None] * kernel * v[None, :]
    total = 0.0
    for i in range(size):
        for j in range(size):
            total += plan[i, j] * cost[i, j]
            total += temperature * plan[i, j] * math.log(plan[i, j] * size)
    return total


def candidate_softmax(scores, near, temperature):
    """Return the loss of candidates that all exist; `near` has a row for each."""
    losses = []
    for k in range(len(near[0])):
        own = sum(math.exp(s / temperature) for s, row in zip(scores, near, strict=True) if row[k])
        false = sum(
            math.exp(s / temperature) for s, row in zip(scores, near, strict=True) if not any(row)
        )
        if own > 0:
            losses.append(-math.log(own / (own + false)))
    return sum(losses) / len(losses) if losses else 0.0


def false_track_loss(gate, votes, false_per_run):
    """Return the loss of tracks that all exist."""
    return sum(max(v - gate, 0.0) for v in votes) + gate * false_per_run
