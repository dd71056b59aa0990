"""OSPA by brute force: equations 42 to 46 of the CSHT paper, over all permutations."""

import itertools
import math

import numpy as np


def ospa(estimates, truths, cutoff, order):
    """Return (distance, localization, cardinality) of two lists of points, all of them valid."""
    few, many = sorted((list(estimates), list(truths)), key=len)
    m, n = len(few), len(many)
    if n == 0:
        return 0.0, 0.0, 0.0
    best = math.inf
    for permutation in itertools.permutations(range(n), m):
        total = 0.0
        for i, j in enumerate(permutation):
            distance = float(np.linalg.norm(np.asarray(few[i]) - np.asarray(many[j])))
            total += min(cutoff, distance) ** order
        best = min(best, total)
    missing = cutoff**order * (n - m)
    return (
        ((best + missing) / n) ** (1 / order),
        (best / n) ** (1 / order),
        (missing / n) ** (1 / order),
    )
