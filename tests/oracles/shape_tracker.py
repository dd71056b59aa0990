"""The likelihood of the tracker by shape, a particle and a point at a time."""

import math

from tests.oracles import moments

ORDERS = [(2, 0), (2, 2), (3, 1), (3, 3), (4, 0), (4, 2), (4, 4)]


def features(points, weights, centre, radius, taper):
    """Return seven complex moments and the mass in the soft window about a centre."""
    xy = [(x - centre[0], y - centre[1]) for x, y in points]
    mass = 0.0
    for (x, y), w in zip(xy, weights, strict=True):
        mass += w * moments.fade(math.hypot(x, y) / radius, taper)
    return [moments.zernike(xy, weights, n, m, radius, taper) for n, m in ORDERS], mass


def template(frames, places, radius, taper):
    """Return mean moments and the geometric mean of masses over frames of (points, weights)."""
    found = [features(*frame, at, radius, taper) for frame, at in zip(frames, places, strict=True)]
    means = [sum(z[k] for z, _ in found) / len(found) for k in range(len(ORDERS))]
    return means, math.prod(mass for _, mass in found) ** (1 / len(found))


def likelihood(found, mass, wanted, wanted_mass, sigma, mass_sigma, floor):
    """Return g, the floor where nothing is in the window."""
    if mass == 0:
        return floor
    apart = sum(abs(a - b) ** 2 for a, b in zip(found, wanted, strict=True))
    light = math.log(mass / wanted_mass)
    fits = math.exp(-apart / (2 * sigma**2)) * math.exp(-(light**2) / (2 * mass_sigma**2))
    return (1 - floor) * fits + floor
