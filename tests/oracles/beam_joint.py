"""The joint vote of a multi-beam sonar, beam by beam: how much its looks speak for a trajectory.

Bearings are positive to starboard; headings turn clockwise from x (north).
"""

import math

LEAST = 1e-6  # what is left of the likelihood ratio where the model grants nothing


def phi(z):
    """Return the standard normal distribution function."""
    return 0.5 * math.erfc(-z / math.sqrt(2.0))


def seen_from_sonar(x, y, pose, mount):
    """Return range and bearing of an earth position: equations 1–3 of the paper, solved."""
    north, east = x - float(pose[0]), y - float(pose[1])
    heading = float(pose[2])
    ahead = math.cos(heading) * north + math.sin(heading) * east - mount[0]
    starboard = math.cos(heading) * east - math.sin(heading) * north - mount[1]
    return math.hypot(ahead, starboard), math.atan2(starboard, ahead)


def beam_shares(beams, spread):
    """Return [(beam, probability)] of the three beams nearest to a bearing given in beams.

    The bearing has a Gaussian error of `spread` beams. What lies beyond the three is the outer
    ones'. Beams are counted from the sector's port edge; those outside 0 … B − 1 do not exist.
    """
    middle = math.floor(beams)
    port = phi((middle - beams) / spread)
    starboard = 1.0 - phi((middle + 1 - beams) / spread)
    return [(middle - 1, port), (middle, 1.0 - port - starboard), (middle + 1, starboard)]


def beam_ratio(range_m, weight, rho, sonar, other):
    """Return p(a beam's report | it holds a target at range rho) / p(the same | it is empty).

    A detection of weight w counts with probability w, and says nothing otherwise. range_m None:
    silent. With probability `other` another target answers, its range anywhere.
    """
    silent = sonar.p_miss * (1.0 - sonar.clutter_in_missed_beam * sonar.p_false)
    silent /= 1.0 - sonar.p_false
    if range_m is None:
        return (1.0 - other) * silent
    sigma = sonar.sigma_m
    density = math.exp(-0.5 * ((range_m - rho) / sigma) ** 2) / (sigma * math.sqrt(2.0 * math.pi))
    clutter = sonar.p_false / sonar.range_max_m
    missed = sonar.p_miss * sonar.clutter_in_missed_beam * clutter
    own = (1.0 - other) * ((1.0 - sonar.p_miss) * density + missed) + other / sonar.range_max_m
    return weight * own / clutter + (1.0 - weight)


def ratio_parts(state, scan, k, sonar, spread, other):
    """Return [(beam, share of the likelihood ratio that is the beam's detection's)], and the ratio.

    The state is at the look's time.
    """
    pose = (*scan.pose.position_m[k], scan.pose.heading_rad[k])
    rho, bearing = seen_from_sonar(float(state[0]), float(state[1]), pose, sonar.mount_m)
    count = scan.range_m.shape[1]
    beams = bearing / (sonar.sector_rad / count) + count / 2.0
    inside = phi((sonar.range_max_m - rho) / sonar.sigma_m)
    total, parts = 1.0 - inside, []
    for beam, share in beam_shares(beams, spread):
        if not 0 <= beam < count:
            total += inside * share
            continue
        weight = 1.0 if scan.weight is None else float(scan.weight[k, beam])
        detected = bool(scan.mask[k, beam])
        range_m = float(scan.range_m[k, beam]) if detected else None
        total += inside * share * beam_ratio(range_m, weight, rho, sonar, other)
        if detected:
            sigma = sonar.sigma_m
            own = math.exp(-0.5 * ((range_m - rho) / sigma) ** 2)
            own *= (1.0 - sonar.p_miss) / (sigma * math.sqrt(2.0 * math.pi))
            own *= (1.0 - other) * sonar.range_max_m / sonar.p_false
            parts.append((beam, inside * share * weight * own))
    return parts, total + LEAST


def log_likelihood_ratio(state, scan, k, sonar, spread, other):
    """Return log p(look k | target at state) − log p(look k | no target)."""
    if not bool(scan.valid[k]):
        return 0.0
    return math.log(ratio_parts(state, scan, k, sonar, spread, other)[1])


def responsibility(state, scan, k, sonar, spread):
    """Return how far the detection of each beam of look k is the target's; there is no other."""
    claims = [0.0] * scan.range_m.shape[1]
    if bool(scan.valid[k]):
        parts, total = ratio_parts(state, scan, k, sonar, spread, 0.0)
        for beam, part in parts:
            claims[beam] = part / total
    return claims


def score(state, t_state, scan, sonar, spread, other):
    """Return a trajectory's log-likelihood ratio summed over the looks; the state is at t_state."""
    total = 0.0
    for k in range(len(scan.time_s)):
        if bool(scan.valid[k]):
            after = float(scan.time_s[k]) - t_state
            there = (state[0] + after * state[2], state[1] + after * state[3])
            total += log_likelihood_ratio(there, scan, k, sonar, spread, other)
    return total
