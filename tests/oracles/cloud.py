"""The cloud model and its association, class by class: equations 2, 10, 11 and 12, readings there.

Samples are a list of (z, weight, σ per axis); a class is a list of sample numbers.
"""

import math

import numpy as np

from tests.oracles.association import gated, squared_distance


def backward(values, weights):
    """Return Ex, En, He of one axis."""
    n = sum(weights)
    ex = sum(w * x for x, w in zip(values, weights, strict=True)) / n
    en = math.sqrt(math.pi / 2) * sum(
        w * abs(x - ex) for x, w in zip(values, weights, strict=True)
    ) / n  # fmt: skip
    square = sum(w * (x - ex) ** 2 for x, w in zip(values, weights, strict=True)) / max(n - 1, 1)
    return ex, en, math.sqrt(abs(square - en**2))


def certainty(z, ex, width):
    """Return u = min over the axes of exp(−(z − Ex)²/(2 En'²))."""
    return min(math.exp(-((x - e) ** 2) / (2 * s**2)) for x, e, s in zip(z, ex, width, strict=True))


def mean_certainty(z, ex, en, he, floor):
    """Return the least over the axes of the mean certainty over the widths."""
    nodes, masses = np.polynomial.hermite.hermgauss(16)
    means = []
    for x, e, n, h, least in zip(z, ex, en, he, floor, strict=True):
        total = 0.0
        for node, mass in zip(nodes, masses, strict=True):
            width = max(abs(n + h * math.sqrt(2) * node), least)
            total += mass * math.exp(-((x - e) ** 2) / (2 * width**2))
        means.append(total / math.sqrt(math.pi))
    return min(means)


def cmeans(samples, start, allowed, centres, xi, tolerance, iterations):
    """Return classes, clouds, u [K][N], J and whether it settled; xi None: mean certainties."""
    u, before = start, math.inf
    classes, clouds = [], []
    for _ in range(iterations):
        classes = [[] for _ in centres]
        for i in range(len(samples)):
            mine = [(u[k][i], -k) for k in range(len(centres)) if allowed[k][i]]
            if mine:
                classes[-max(mine)[1]].append(i)
        clouds, u = [], np.zeros((len(centres), len(samples)))
        objective = 0.0
        for k, members in enumerate(classes):
            cloud = [(centre, 0.0, 0.0) for centre in centres[k]]
            if members:
                weights = [samples[i][1] for i in members]
                cloud = [
                    backward([samples[i][0][axis] for i in members], weights)
                    for axis in range(len(centres[k]))
                ]
            ex, en, he = zip(*cloud, strict=True)
            clouds.append((ex, en, he))
            for i, (z, weight, sigma) in enumerate(samples):
                if not allowed[k][i]:
                    continue
                if xi is None:
                    u[k, i] = mean_certainty(z, ex, en, he, sigma)
                else:
                    drawn = [abs(n + h * x) for n, h, x in zip(en, he, xi[k], strict=True)]
                    width = [max(d, s) for d, s in zip(drawn, sigma, strict=True)]
                    u[k, i] = certainty(z, ex, width)
                apart = sum((a - b) ** 2 for a, b in zip(z, ex, strict=True))
                objective += weight * u[k, i] ** 2 * apart
        if abs(objective - before) < tolerance:
            return classes, clouds, u, objective, True
        before = objective
    return classes, clouds, u, before, False


def associate(tracks, detections, noise, gate, xi, pairing, iterations=12):
    """Return {i: weight} for each track; `noise` is R, detections as in `association`."""
    pairs = gated(tracks, detections, gate)
    held = [i for i in range(len(detections)) if any((j, i) in pairs for j in range(len(tracks)))]
    samples = [
        (detections[i][0], detections[i][2], np.sqrt(np.diagonal(detections[i][1]))) for i in held
    ]
    allowed = [[(j, i) in pairs for i in held] for j in range(len(tracks))]
    start = [
        [math.exp(-pairs[j, i]) if (j, i) in pairs else 0.0 for i in held]
        for j in range(len(tracks))
    ]
    centres = [(0.0, 0.0) if track is None else tuple(track[0]) for track in tracks]
    classes, clouds, *_ = cmeans(samples, start, allowed, centres, xi, 1e-6, iterations)
    taken = [{held[i]: samples[i][1] for i in members} for members in classes]
    if pairing == "class":
        return taken
    near = sorted(
        (d, j, k)
        for j, track in enumerate(tracks)
        for k, members in enumerate(classes)
        if track is not None and members
        for d in [squared_distance(track, (clouds[k][0], noise))]
        if d < gate
    )
    paired, used = [{} for _ in tracks], set()
    free = set(range(len(tracks)))
    for _, j, k in near:
        if j in free and k not in used:
            paired[j] = taken[k]
            free.remove(j)
            used.add(k)
    return paired
