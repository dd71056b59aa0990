"""Joint probabilistic data association by enumeration of all joint events."""

import itertools

import numpy as np


def marginals(w, missed):
    """Return p [T][M + 1], the last column the miss, of weights w [T][M] and w_0 [T]."""
    tracks, detections = np.shape(w)
    total = np.zeros((tracks, detections + 1))
    for event in itertools.product(range(detections + 1), repeat=tracks):
        used = [i for i in event if i < detections]
        if len(used) != len(set(used)):
            continue
        weight = 1.0
        for j, i in enumerate(event):
            weight *= w[j][i] if i < detections else missed[j]
            if weight == 0.0:
                break
        if weight > 0.0:
            for j, i in enumerate(event):
                total[j, i] += weight
    return total / total.sum(1, keepdims=True)
