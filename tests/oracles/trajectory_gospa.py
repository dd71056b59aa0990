"""Trajectory GOSPA as it is defined, by brute force over sequences of assignments, and its LP.

Tracks are [T, I, D] tables with a mask [T, I]; all numbers are p-th powers until the end.
"""

import itertools
import math

import numpy as np
from scipy.optimize import linprog


def partial_assignments(rows, columns):
    """Return every one-to-one map from rows to columns or to none (−1), as tuples."""
    return [
        choice
        for choice in itertools.product(range(-1, columns), repeat=rows)
        if len({j for j in choice if j >= 0}) == sum(j >= 0 for j in choice)
    ]


def look_cost(x, x_mask, y, y_mask, assignment, cutoff, order):
    """Return the powered localization, missed and false costs of one look."""
    localization, missed, false = 0.0, list(y_mask), list(x_mask)
    for i, j in enumerate(assignment):
        if j >= 0 and x_mask[i] and y_mask[j]:
            distance = float(np.linalg.norm(x[i] - y[j]))
            if distance < cutoff:
                localization += distance**order
                missed[j] = false[i] = False
    penalty = cutoff**order / 2
    return np.array([localization, penalty * sum(missed), penalty * sum(false), 0.0])


def switches(before, after):
    total = 0.0
    for a, b in zip(before, after, strict=True):
        if a != b:
            total += 1.0 if a >= 0 and b >= 0 else 0.5
    return total


def brute_force(x, x_mask, y, y_mask, cutoff, order, gamma):
    """Return the roots (distance, localization, missed, false, switch)."""
    choices = partial_assignments(x.shape[1], y.shape[1])
    looks = [
        [look_cost(x[t], x_mask[t], y[t], y_mask[t], choice, cutoff, order) for choice in choices]
        for t in range(len(x))
    ]
    best, parts = math.inf, np.zeros(4)
    for sequence in itertools.product(range(len(choices)), repeat=len(x)):
        cost = sum(looks[t][k] for t, k in enumerate(sequence))
        turns = sum(switches(choices[a], choices[b]) for a, b in itertools.pairwise(sequence))
        cost = cost + np.array([0.0, 0.0, 0.0, gamma**order * turns])
        if cost.sum() < best:
            best, parts = cost.sum(), cost
    return (best ** (1 / order), *(part ** (1 / order) for part in parts))


def linear_programme(x, x_mask, y, y_mask, cutoff, order, gamma):
    """Return the relaxation, which is at most the distance: W real, |ΔW| by slack variables."""
    looks, n, m = len(x), x.shape[1], y.shape[1]
    weights = (n + 1) * (m + 1)
    variables = looks * weights + (looks - 1) * n * m
    w = lambda t, i, j: t * weights + i * (m + 1) + j
    e = lambda t, i, j: looks * weights + t * n * m + i * m + j
    cost, upper = np.zeros(variables), np.full(variables, np.inf)
    penalty = cutoff**order / 2
    equal, equal_to, less = [], [], []
    for t in range(looks):
        for i, j in itertools.product(range(n + 1), range(m + 1)):
            there_x, there_y = i < n and x_mask[t, i], j < m and y_mask[t, j]
            if there_x and there_y:
                distance = float(np.linalg.norm(x[t, i] - y[t, j]))
                cost[w(t, i, j)] = min(distance, cutoff) ** order
            elif there_x or there_y:
                cost[w(t, i, j)] = penalty
        upper[w(t, n, m)] = 0.0
        for line in [[w(t, i, j) for j in range(m + 1)] for i in range(n)] + [
            [w(t, i, j) for i in range(n + 1)] for j in range(m)
        ]:
            row = np.zeros(variables)
            row[line] = 1.0
            equal.append(row)
            equal_to.append(1.0)
    for t, i, j in itertools.product(range(looks - 1), range(n), range(m)):
        cost[e(t, i, j)] = gamma**order / 2
        for sign in (1.0, -1.0):
            row = np.zeros(variables)
            row[w(t + 1, i, j)], row[w(t, i, j)], row[e(t, i, j)] = sign, -sign, -1.0
            less.append(row)
    found = linprog(
        cost,
        A_ub=np.array(less) if less else None,
        b_ub=np.zeros(len(less)) if less else None,
        A_eq=np.array(equal),
        b_eq=equal_to,
        bounds=[(0.0, None if np.isinf(u) else u) for u in upper],
    )
    assert found.success
    return max(found.fun, 0.0) ** (1 / order)
