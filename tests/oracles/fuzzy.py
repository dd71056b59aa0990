"""Fuzzy c-means and fuzzy ISODATA, sample by sample: equations 20–37 of the CSHT paper.

Patterns live in slots: a list of centres, None where a slot is free.
"""

import math

import numpy as np


def squared_distance(x, z):
    """Return ‖x − z‖²."""
    return sum((float(a) - float(b)) ** 2 for a, b in zip(x, z, strict=True))


def coincide(x, z):
    """Whether two places are one, up to rounding."""
    scale = math.sqrt(squared_distance(x, np.zeros(len(x))))
    return math.sqrt(squared_distance(x, z)) <= 1e-15 * scale


def memberships(samples, centres, m):
    """Return μ_ij [K][N]: equation 22; centres that coincide with a sample share it equally."""
    mu = np.zeros((len(centres), len(samples)))
    slots = [i for i, z in enumerate(centres) if z is not None]
    for j, x in enumerate(samples):
        d = {i: math.sqrt(squared_distance(x, centres[i])) for i in slots}
        on_it = [i for i in slots if coincide(x, centres[i])]
        for i in slots:
            if on_it:
                mu[i, j] = 1.0 / len(on_it) if i in on_it else 0.0
            else:
                mu[i, j] = 1.0 / sum((d[i] / d[k]) ** (2.0 / (m - 1.0)) for k in slots)
    return mu


def update(samples, weights, centres, m):
    """Return the centres of equation 23; one that no sample belongs to stays."""
    mu = memberships(samples, centres, m)
    moved = []
    for i, z in enumerate(centres):
        if z is None:
            moved.append(None)
            continue
        total, mean = 0.0, np.zeros(len(z))
        for j, x in enumerate(samples):
            share = weights[j] * mu[i, j] ** m
            total += share
            mean += share * np.asarray(x, float)
        moved.append(mean / total if total > 0.0 else np.array(z, float))
    return moved


def cmeans(samples, weights, centres, m, iterations):
    """Return the centres after so many updates."""
    for _ in range(iterations):
        centres = update(samples, weights, centres, m)
    return centres


def objective(samples, weights, centres, m):
    """Return J of equation 21, of squared distances."""
    mu = memberships(samples, centres, m)
    return sum(
        weights[j] * mu[i, j] ** m * squared_distance(x, z)
        for i, z in enumerate(centres)
        if z is not None
        for j, x in enumerate(samples)
    )


def merge(samples, weights, centres, m, alpha_c):
    """Return the centres after all combinations, closest pair first: equations 24–26.

    Centres that coincide up to rounding are one pattern, whatever the threshold.
    """
    centres = [None if z is None else np.array(z, float) for z in centres]
    mu = memberships(samples, centres, m)
    mass = [sum(weights[k] * mu[i, k] for k in range(len(samples))) for i in range(len(centres))]
    slots = [i for i, z in enumerate(centres) if z is not None]
    pairs = [(i, j) for i in slots for j in slots if i < j]
    if not pairs:
        return centres
    mean = sum(math.sqrt(squared_distance(centres[i], centres[j])) for i, j in pairs) / len(pairs)
    threshold = mean * (1.0 - len(slots) ** (-alpha_c))
    while True:
        near = [
            (math.sqrt(squared_distance(centres[i], centres[j])), i, j)
            for i, j in pairs
            if centres[i] is not None and centres[j] is not None
        ]
        if not near:
            return centres
        distance, i, j = min(near)
        scale = math.sqrt(squared_distance(centres[i], np.zeros(len(centres[i]))))
        if distance >= threshold and distance > 1e-14 * scale:
            return centres
        if mass[i] + mass[j] > 0.0:
            centres[i] = (mass[i] * centres[i] + mass[j] * centres[j]) / (mass[i] + mass[j])
        else:
            centres[i] = (centres[i] + centres[j]) / 2.0
        mass[i] += mass[j]
        centres[j] = None


def statistics(samples, weights, centres, m, gamma, theta):
    """Return S [K][n], F_std [n], C [K], T [K]: equations 27–33, of weighted samples."""
    n, features = len(samples), len(next((z for z in centres if z is not None), [0.0, 0.0]))
    mu = memberships(samples, centres, m)
    total = sum(weights)
    slots = [i for i, z in enumerate(centres) if z is not None]
    spread = np.zeros((len(centres), features))
    aggregation, count = np.zeros(len(centres)), np.zeros(len(centres))
    for i in slots:
        for f in range(features):
            if total > 1.0:
                square = sum(
                    weights[k] * mu[i, k] * (samples[k][f] - centres[i][f]) ** 2 for k in range(n)
                )
                spread[i, f] = math.sqrt(square / (total - 1.0))
        q = 0.0
        for k in range(n):
            if mu[i, k] > theta:
                q += weights[k] * mu[i, k]
                count[i] += weights[k]
        aggregation[i] = q / count[i] if count[i] > 0.0 else 0.0
    threshold = np.zeros(features)
    if slots:
        for f in range(features):
            mean = sum(spread[i, f] for i in slots) / len(slots)
            threshold[f] = mean * (1.0 + len(slots) ** (-gamma))
    return spread, threshold, aggregation, count


def delete(centres, total, spread, threshold, aggregation, count, a, delta):
    """Return the centres without those of conditions 36 and 37."""
    patterns = sum(z is not None for z in centres)
    kept = []
    for i, z in enumerate(centres):
        if z is not None:
            few = count[i] <= delta * total / patterns
            loose = aggregation[i] <= a and all(
                s <= f for s, f in zip(spread[i], threshold, strict=True)
            )
            z = None if few or loose else z
        kept.append(z)
    return kept


def divide(centres, spread, threshold, aggregation, a, lambda_d):
    """Return the centres after divisions, widest first, one feature each: equations 34 and 35."""
    centres = [None if z is None else np.array(z, float) for z in centres]
    wide = []
    for i, z in enumerate(centres):
        if z is None or aggregation[i] > a:
            continue
        excess = [s / f if s > f else 0.0 for s, f in zip(spread[i], threshold, strict=True)]
        if max(excess) > 0.0:
            wide.append((-max(excess), i, excess.index(max(excess))))
    free = [i for i, z in enumerate(centres) if z is None]
    for (_, i, f), slot in zip(sorted(wide), free, strict=False):
        step = np.zeros(len(threshold))
        step[f] = lambda_d * spread[i, f]
        centres[i], centres[slot] = centres[i] + step, centres[i] - step
    return centres


def isodata(samples, weights, centres, p, *, rounds, updates, iterations):
    """Return the centres of fuzzy ISODATA, `p` a dict of its parameters.

    A round: some updates, combination, deletion, division (not in the last round); the rounds end
    when one of them changes no pattern. Then c-means.
    """
    centres = [None if z is None else np.array(z, float) for z in centres]
    total = sum(weights)
    for r in range(rounds):
        centres = cmeans(samples, weights, centres, p["m"], updates)
        before = [None if z is None else z.copy() for z in centres]
        centres = merge(samples, weights, centres, p["m"], p["alpha_c"])
        found = statistics(samples, weights, centres, p["m"], p["gamma"], p["theta"])
        spread, threshold, aggregation, _ = found
        centres = delete(centres, total, *found, p["a"], p["delta"])
        if r < rounds - 1:
            centres = divide(centres, spread, threshold, aggregation, p["a"], p["lambda_d"])
        if all(
            (a is None and b is None) or (a is not None and b is not None and np.array_equal(a, b))
            for a, b in zip(before, centres, strict=True)
        ):
            break
    return cmeans(samples, weights, centres, p["m"], iterations)
