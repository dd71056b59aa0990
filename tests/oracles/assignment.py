"""Brute force over all matchings: the linear assignment problem as it is defined."""

import itertools

import numpy as np


def least_cost_matching(cost, allowed):
    """Return (number of pairs, total cost) of the best matching; more pairs go before less cost."""
    cost = np.asarray(cost, dtype=np.float64)
    allowed = np.asarray(allowed)
    rows, columns = cost.shape
    for size in range(min(rows, columns), 0, -1):
        totals = [
            sum(cost[i, j] for i, j in zip(chosen, order, strict=True))
            for chosen in itertools.combinations(range(rows), size)
            for order in itertools.permutations(range(columns), size)
            if all(allowed[i, j] for i, j in zip(chosen, order, strict=True))
        ]
        if totals:
            return size, min(totals)
    return 0, 0.0
