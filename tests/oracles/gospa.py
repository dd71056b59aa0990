"""GOSPA (α = 2) by brute force over all assignments that may leave out anybody."""

import math

import numpy as np


def gospa(estimates, truths, cutoff, order):
    """Return the roots (distance, localization, missed, false) of two lists of valid points."""
    penalty = cutoff**order / 2
    distance = [
        [float(np.linalg.norm(np.asarray(x) - np.asarray(y))) for y in truths] for x in estimates
    ]
    best = (math.inf, 0.0, 0.0, 0.0)

    def extend(row, taken, localization):
        nonlocal best
        if row == len(distance):
            missed = penalty * (len(truths) - len(taken))
            false = penalty * (len(distance) - len(taken))
            total = localization + missed + false
            if total < best[0]:
                best = (total, localization, missed, false)
            return
        extend(row + 1, taken, localization)
        for column in range(len(truths)):
            if column not in taken:
                extend(row + 1, taken | {column}, localization + distance[row][column] ** order)

    extend(0, frozenset(), 0.0)
    return tuple(part ** (1 / order) for part in best)
