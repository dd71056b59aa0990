"""The Zernike paper's tracker a particle at a time, with the random numbers handed in."""

import math

from tests.oracles import moments

ORDERS = {
    "zernike": [(3, 1), (5, 3), (7, 3), (7, 5), (9, 3), (9, 5), (9, 7)],
    "low_zernike": [(2, 0), (2, 2), (3, 1), (3, 3), (4, 0), (4, 2), (4, 4)],
}


def features(points, weights, centre, kind, origin, radius):
    """Return seven features of the points about a centre, or None if they are fewer than three."""
    near = [
        (x - centre[0], y - centre[1], w)
        for (x, y), w in zip(points, weights, strict=True)
        if w > 0 and math.hypot(x - centre[0], y - centre[1]) <= radius
    ]
    if len(near) < 3:
        return None
    xy, w = [(x, y) for x, y, _ in near], [w for _, _, w in near]
    if kind == "hu":
        values = moments.hu(xy, w)
    else:
        if origin == "centroid":
            mean = [
                sum(a[axis] * b for a, b in zip(xy, w, strict=True)) / sum(w) for axis in (0, 1)
            ]
            xy = [(x - mean[0], y - mean[1]) for x, y in xy]
        values = [moments.zernike(xy, w, n, m, radius) for n, m in ORDERS[kind]]
    return [abs(math.log10(abs(value))) for value in values]


def angle(a, b):
    dot = sum(x * y for x, y in zip(a, b, strict=True))
    length = math.sqrt(sum(x * x for x in a) * sum(y * y for y in b))
    return math.acos(max(-1.0, min(1.0, dot / length)))


def threshold(angles):
    """Return the angle at two thirds of those that are not None."""
    some = sorted(a for a in angles if a is not None)
    return some[math.ceil(2 * len(some) / 3) - 1]


def weigh(weights, angles, limit, sigma):
    """Return new weights, and whether all vanished and stayed as they were."""
    new = [
        0.0 if a is None or a >= limit else w * math.exp((limit - a) / limit / (2 * sigma**2))
        for w, a in zip(weights, angles, strict=True)
    ]
    total = sum(new)
    return (weights, True) if total == 0 else ([w / total for w in new], False)


def turned(step, apart):
    """Return a step of mode 2."""
    gx, gy = map(abs, step)
    slope = 90.0 if apart[0] == 0 else math.degrees(math.atan(abs(apart[1] / apart[0])))
    if slope < 30:
        gx, gy = max(gx, gy), min(gx, gy)
    elif slope > 60:
        gx, gy = min(gx, gy), max(gx, gy)
    return math.copysign(gx, apart[0]), math.copysign(gy, apart[1])
