"""Detections that count, and the candidate pairs of consecutive looks: equations 4 and 20 to 22."""

import math
from typing import NamedTuple

import numpy as np


class Detection(NamedTuple):
    """A detection that counts."""

    index: int  # within its look
    position: np.ndarray  # [2]
    time: float
    weight: float


class Pair(NamedTuple):
    """A candidate pair of interval k: detection i of look k − 1, then detection j of look k."""

    k: int
    i: int
    j: int
    first: np.ndarray  # [2]
    second: np.ndarray  # [2]
    t_first: float
    t_second: float
    weight: float


def detections(scan, k):
    """Return the detections of look k that count, in order: mask and valid, time_s + delay_s."""
    found = []
    if not bool(scan.valid[k]):
        return found
    for n in range(len(scan.mask[k])):
        if not bool(scan.mask[k][n]):
            continue
        position = np.array(scan.position_m[k][n], dtype=np.float64)
        delay = 0.0 if scan.delay_s is None else float(scan.delay_s[k][n])
        weight = 1.0 if scan.weight is None else float(scan.weight[k][n])
        found.append(Detection(n, position, float(scan.time_s[k]) + delay, weight))
    return found


def candidate_pairs(scan, v_min=None, v_max=None):
    """Return all pairs of consecutive looks (equations 4, 22), within the speeds of equation 20.

    Their order is the interval k, then the second detection j, then the first detection i.
    A detection of weight 0 counts as none.
    """
    found = []
    for k in range(1, len(scan.time_s)):
        for b in detections(scan, k):
            for a in detections(scan, k - 1):
                length = math.hypot(*(b.position - a.position))
                elapsed = b.time - a.time
                if length == 0.0 or elapsed <= 0.0:
                    continue
                speed = length / elapsed
                if v_min is not None and speed < v_min:
                    continue
                if v_max is not None and speed > v_max:
                    continue
                weight = a.weight * b.weight
                if weight == 0.0:
                    continue
                pair = Pair(k, a.index, b.index, a.position, b.position, a.time, b.time, weight)
                found.append(pair)
    return found
