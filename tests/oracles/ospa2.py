"""OSPA(2) by brute force: tracks are dicts from look to point, pairs are tried in every order."""

import itertools
import math

import numpy as np


def base_distance(f, g, cutoff):
    """Return the mean over the looks where one of two tracks exists of their cut-off distance."""
    looks = sorted(set(f) | set(g))
    if not looks:
        return 0.0
    total = 0.0
    for look in looks:
        if look in f and look in g:
            total += min(cutoff, float(np.linalg.norm(np.asarray(f[look]) - np.asarray(g[look]))))
        else:
            total += cutoff
    return total / len(looks)


def ospa2(estimates, truths, cutoff, order):
    """Return (distance, localization, cardinality) of two lists of tracks; empty ones are none."""
    few, many = sorted(([f for f in x if f] for x in (estimates, truths)), key=len)
    m, n = len(few), len(many)
    if n == 0:
        return 0.0, 0.0, 0.0
    best = math.inf
    for permutation in itertools.permutations(range(n), m):
        pairs = zip(few, permutation, strict=True)
        best = min(best, sum(base_distance(f, many[j], cutoff) ** order for f, j in pairs))
    missing = cutoff**order * (n - m)
    return tuple((part / n) ** (1 / order) for part in (best + missing, best, missing))


def tracks_of(state, mask):
    """Return the columns of [T, I, D] as tracks."""
    return [
        {t: state[t, i] for t in range(state.shape[0]) if mask[t, i]} for i in range(state.shape[1])
    ]


def trajectories(state, mask, identity, identities):
    """Lay tables [T, M] out by identity, one entry after the other."""
    names = sorted(
        {
            int(identity[t, m])
            for t, m in np.ndindex(identity.shape)
            if mask[t, m] and identity[t, m] >= 0
        }
    )
    kept = names[:identities]
    out = np.zeros((state.shape[0], identities, state.shape[2]))
    there = np.zeros((state.shape[0], identities), bool)
    for t, m in np.ndindex(identity.shape):
        if mask[t, m] and identity[t, m] in kept:
            column = kept.index(identity[t, m])
            out[t, column], there[t, column] = state[t, m], True
    number = kept + [-1] * (identities - len(kept))
    return out, there, np.array(number), len(names) > identities
