"""How far a sonar is turned: the paper's triangle, and a search for the least of squares."""

import math

from tests.oracles import frames


def sighting(target, vehicle, heading, mount, beta):
    """Return range and bearing in the frame of a sonar that is turned by β."""
    range_m, bearing = frames.to_polar(target, vehicle, heading, mount)
    return range_m, bearing - beta


def triangle(ranges, bearings, vehicles, yaw):
    """Return β by equations 1–5, the side of A from the sonar's own vectors."""
    (xb, yb), (xc, yc) = vehicles
    gamma = math.atan2(yc - yb, xc - xb)
    a, b, c = math.hypot(xc - xb, yc - yb), ranges[1], ranges[0]
    corner = math.acos(min(1.0, max(-1.0, (a * a + c * c - b * b) / (2 * a * c))))
    (ub, vb), (uc, vc) = (
        (r * math.cos(t), r * math.sin(t)) for r, t in zip(ranges, bearings, strict=True)
    )
    side = math.copysign(1.0, ub * vc - vb * uc)
    beta = gamma - yaw - (math.atan2(vb, ub) - side * corner)
    return math.atan2(math.sin(beta), math.cos(beta))


def spread(beta, ranges, bearings, vehicles, headings, mount):
    """Return the mean square by which the target's places differ from their mean."""
    places = [
        frames.to_earth(r, b + beta, v, h, mount)
        for r, b, v, h in zip(ranges, bearings, vehicles, headings, strict=True)
    ]
    n = len(places)
    mean = [sum(p[axis] for p in places) / n for axis in (0, 1)]
    return sum((p[0] - mean[0]) ** 2 + (p[1] - mean[1]) ** 2 for p in places) / n, mean


def least_squares(*sightings):
    """Return β of the least spread: a grid over the circle, then thirds."""
    grid = [math.radians(d) for d in range(-180, 180)]
    start = min(grid, key=lambda beta: spread(beta, *sightings)[0])
    low, high = start - math.radians(1.5), start + math.radians(1.5)
    for _ in range(200):
        one, two = low + (high - low) / 3, high - (high - low) / 3
        if spread(one, *sightings)[0] < spread(two, *sightings)[0]:
            high = two
        else:
            low = one
    return (low + high) / 2
