"""Which of several detections start tracks, one a neighbourhood, pair by pair."""

import numpy as np


def starts(places, covariances, weights, mask, limit):
    """Return the indices of the detections that start a track, in order."""
    there = [i for i in range(len(places)) if mask[i]]
    near = {i: {} for i in there}
    for i in there:
        for k in there:
            apart = places[i] - places[k]
            square = apart @ np.linalg.solve(covariances[i] + covariances[k], apart)
            if square < limit:
                near[i][k] = weights[k] * np.exp(-square / 2)
    rank = {i: (-sum(near[i].values()), *places[i]) for i in there}
    return [i for i in there if all(rank[i] <= rank[k] for k in near[i])]
