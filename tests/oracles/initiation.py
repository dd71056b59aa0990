"""Scores of track initiation in plain loops, from the definitions."""

import math

import numpy as np


def rms_distance(rho, theta, positions):
    """Return the root mean square distance of positions [T, 2] to one line."""
    squares = [(x * math.cos(theta) + y * math.sin(theta) - rho) ** 2 for x, y in positions]
    return math.sqrt(sum(squares) / len(squares))


def fit_line(positions):
    """Return (ρ, θ) of the total least-squares line by a singular value decomposition."""
    positions = np.asarray(positions)
    centre = positions.mean(axis=0)
    normal = np.linalg.svd(positions - centre)[2][1]
    theta = math.atan2(normal[1], normal[0])
    rho = float(centre @ normal)
    if theta < 0:
        theta, rho = theta + math.pi, -rho
    if theta >= math.pi:
        theta, rho = theta - math.pi, -rho
    return rho, theta


def difference(rho, theta, from_rho, from_theta):
    """Return (Δρ, Δθ), the closest in angle of the three ways to write the first line."""
    writings = [(rho, theta), (-rho, theta + math.pi), (-rho, theta - math.pi)]
    nearest = min(writings, key=lambda line: abs(line[1] - from_theta))
    return nearest[0] - from_rho, nearest[1] - from_theta


def initiation_scores(lines, targets, match, gate):
    """Score lines [(ρ, θ, votes)] against targets [positions [T, 2]], all of them valid."""
    owner = []
    for rho, theta, _ in lines:
        distances = [rms_distance(rho, theta, positions) for positions in targets]
        nearest = int(np.argmin(distances)) if distances else -1
        owner.append(nearest if distances and distances[nearest] <= match else -1)

    found, false, redundant = set(), 0, 0
    for (_, _, votes), target in zip(lines, owner, strict=True):
        if votes < gate:
            continue
        if target < 0:
            false += 1
        elif target in found:
            redundant += 1
        else:
            found.add(target)

    errors, own_votes = {}, []
    for target, positions in enumerate(targets):
        own = [line for line, whose in zip(lines, owner, strict=True) if whose == target]
        own.sort(key=lambda line: (-line[2], rms_distance(line[0], line[1], positions)))
        own_votes.append(own[0][2] if own else 0.0)
        if target in found:
            errors[target] = difference(*own[0][:2], *fit_line(positions))

    # The strongest lines, true ones last among equals, so that ties count against the method.
    number = len(targets)
    by_votes = sorted(range(len(lines)), key=lambda line: -lines[line][2])
    strongest = by_votes[:number]
    top_k = sorted(owner[line] for line in strongest) == list(range(number))
    if 0 < number < len(lines):
        top_k = top_k and lines[by_votes[number]][2] < lines[by_votes[number - 1]][2]

    false_votes = [line[2] for line, whose in zip(lines, owner, strict=True) if whose < 0]
    return {
        "found": len(found),
        "false": false,
        "redundant": redundant,
        "perfect": len(found) == number and false == 0 and redundant == 0,
        "top_k": top_k,
        "errors": errors,
        "weakest_true_votes": min(own_votes, default=0.0),
        "strongest_false_votes": max(false_votes, default=0.0),
    }
