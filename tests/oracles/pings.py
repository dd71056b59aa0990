"""Mean power of a mechanically scanned sonar's cells: one facet or ray after the other."""

import math

from tests.oracles import frames


def pattern(angle, width):
    """Return the two-way power of an even aperture; it has half its power at half the width."""
    if math.cos(angle) <= 0:
        return 0.0
    low, high = 0.1, 0.9  # where sin²(πx) / (πx)² is ½, by bisection
    for _ in range(60):
        middle = (low + high) / 2
        big = (math.sin(math.pi * middle) / (math.pi * middle)) ** 2 > 0.5
        low, high = (middle, high) if big else (low, middle)
    x = math.pi * low * math.sin(angle) / math.sin(width / 2)
    return 1.0 if x == 0 else (math.sin(x) / x) ** 4


def _deposit(row, range_m, power, scope):
    """Add an echo as long as a bin, centred on its range, by what of it lies in each bin."""
    bins = len(row)
    size = scope / bins
    if not 0 <= range_m < scope:
        return
    for r in range(bins):
        low, high = max(range_m - size / 2, r * size), min(range_m + size / 2, (r + 1) * size)
        if r == 0:
            low = range_m - size / 2  # what lies before the first bin is counted into it
        if r == bins - 1:
            high = range_m + size / 2
        row[r] += power * max(0.0, high - low) / size


def ping(bins, scope, axis, vehicle, heading, mount, widths, cylinders, facets):
    """Return the power in each bin of one ping from (centre, radius, level, depth) cylinders."""
    row = [0.0] * bins
    sonar = frames.to_earth(0.0, 0.0, vehicle, heading, mount)
    for centre, radius, level_db, depth in cylinders:
        back = math.atan2(sonar[1] - centre[1], sonar[0] - centre[0])
        sines = [2 * (k + 0.5) / facets - 1 for k in range(facets)]
        cosines = [math.cos(math.asin(s)) for s in sines]
        for s, c in zip(sines, cosines, strict=True):
            turn = back + math.asin(s)
            at = centre[0] + radius * math.cos(turn), centre[1] + radius * math.sin(turn)
            flat, bearing = frames.to_polar(at, vehicle, heading, mount)
            slant = math.hypot(flat, depth)
            power = 10 ** (level_db / 10) * c / sum(cosines) * 10.0 / slant
            power *= pattern(bearing - axis, widths[0])
            power *= pattern(math.atan2(depth, flat), widths[1])
            _deposit(row, slant, power, scope)
    return row


def dike_ping(bins, scope, axis, vehicle, heading, mount, width, rho, theta, level_db, rays):
    """Return the power in each bin of one ping from a sheer wall ρ = x cos θ + y sin θ."""
    row = [0.0] * bins
    sonar = frames.to_earth(0.0, 0.0, vehicle, heading, mount)
    offsets = [(2 * (k + 0.5) / rays - 1) * width for k in range(rays)]
    total = sum(pattern(off, width) for off in offsets)
    for off in offsets:
        way = heading + axis + off
        nears = math.cos(way) * math.cos(theta) + math.sin(way) * math.sin(theta)
        gap = rho - sonar[0] * math.cos(theta) - sonar[1] * math.sin(theta)
        if gap * nears > 0:
            power = 10 ** (level_db / 10) * pattern(off, width) / total * abs(nears)
            _deposit(row, gap / nears, power, scope)
    return row


def crossing(places, bearings, vehicles, headings, mount, beta):
    """Return the ping whose axis is nearest to a target."""
    best, ping = math.inf, -1
    for q, bearing in enumerate(bearings):
        seen = frames.to_polar(places[q], vehicles[q], headings[q], mount)[1]
        off = seen - bearing - beta
        off = abs(math.atan2(math.sin(off), math.cos(off)))
        if off < best:
            best, ping = off, q
    return ping, best


def cloud(sweep, threshold, scope, mount, beta, points):
    """Return (position, intensity, weight, time) of loud cells, the nearest first, and overflow.

    A sweep is a list of (time, bearing, vehicle, heading, amplitudes), None where there is no ping.
    """
    found = []
    for ping in sweep:
        if ping is None:
            continue
        time, bearing, vehicle, heading, row = ping
        for r, a in enumerate(row):
            if a >= threshold:
                range_m = (r + 0.5) * scope / len(row)
                at = frames.to_earth(range_m, bearing + beta, vehicle, heading, mount)
                found.append((range_m, at, a, 1 - (threshold / a) ** 2, time))
    found.sort(key=lambda cell: cell[0])
    return [cell[1:] for cell in found[:points]], len(found) > points


def linked(points, weights, gaps, members):
    """Return clusters (members' indices, mass, centre) by walking from point to point."""
    left, clusters = set(range(len(points))), []
    while left:
        walk, cluster = [left.pop()], []
        while walk:
            here = walk.pop()
            cluster.append(here)
            apart = {n: math.dist(points[n], points[here]) for n in left}
            near = {n for n, d in apart.items() if d <= max(gaps[n], gaps[here])}
            left -= near
            walk += near
        if len(cluster) >= members:
            mass = sum(weights[n] for n in cluster)
            centre = [
                sum(weights[n] * points[n][axis] for n in cluster) / mass for axis in range(2)
            ]
            clusters.append((sorted(cluster), mass, centre))
    return sorted(clusters, key=lambda cluster: -cluster[1])
