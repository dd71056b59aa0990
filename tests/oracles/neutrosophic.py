"""The neutrosophic votes of candidate pairs: equations 13 to 19 and 23 to 31."""

import math
from typing import NamedTuple

import numpy as np

from tests.oracles import lines
from tests.oracles.pairs import Pair, candidate_pairs


class Member(NamedTuple):
    """A pair, its line, and what it is worth."""

    pair: Pair
    rho: float
    theta: float
    covariance: np.ndarray  # [2, 2] of (ρ, θ)
    T: float  # T, I and F before they are normalised to T + I + F = 1
    I: float  # noqa: E741 (the equations' letter)
    F: float
    vote: float  # times the pair's weight
    kernel: "Member | None"  # the best kernel o1, None without any in the box


def scale_between(p, o, eps_rho, eps_theta, scale):
    """Return S of the comparison of p with o, in p's representation: equation 27."""
    if scale == "tolerance":
        return lines.tolerance_scale(eps_rho, eps_theta)
    assert scale == "covariance", scale
    return lines.summed_covariance(p.covariance, p.theta, o.covariance, o.theta)


def in_gate(pair, kernel, p_gate, sigma):
    """Return whether the pair's second detection is in the kernel's association gate: Fig. 1."""
    a, b = kernel.first, kernel.second
    r = (pair.t_second - kernel.t_second) / (kernel.t_second - kernel.t_first)
    miss = pair.second - (b + r * (b - a))
    variance = sigma**2 * ((1.0 + r) ** 2 + r**2 + 1.0)
    return float(miss @ miss) <= -2.0 * math.log(1.0 - p_gate) * variance


def uncertain_membership(p, o1, o2, origin, scale):
    """Return μ of p and the line midway between two kernels, 0 out of the box: equations 17, 27."""
    first = 0.5 * (o1.pair.first + o2.pair.first)
    second = 0.5 * (o1.pair.second + o2.pair.second)
    if np.array_equal(first, second):
        return 0.0
    delta = lines.difference(p.rho, p.theta, *lines.line_through(first, second, origin))
    return lines.gaussian(*delta, scale) if lines.in_box(*delta, scale) else 0.0


def memberships(
    scan, origin, eps_rho, eps_theta, p_false, lambda_k, p_gate, sigma,
    v_min, v_max, share_measurement, scale, first_interval_votes,
):  # fmt: skip
    """Return one `Member` a pair, in the pairs' order: equations 24 and 27 to 30."""
    members = []
    for pair in candidate_pairs(scan, v_min, v_max):
        rho, theta = lines.line_through(pair.first, pair.second, origin)
        covariance = lines.line_covariance(pair.first, pair.second, origin, sigma)
        falsity = lambda_k * p_false
        p = Member(pair, rho, theta, covariance, 1.0 - p_false, 0.0, falsity, 0.0, None)
        if pair.k == 1:
            vote = (1.0 - p_false) * pair.weight if first_interval_votes else 0.0
            members.append(p._replace(vote=vote))
            continue

        near = []  # (w_o μ, kernel, S) of the kernels in the box
        for o in members:
            if o.pair.k != pair.k - 1 or (share_measurement and o.pair.j != pair.i):
                continue
            s = scale_between(p, o, eps_rho, eps_theta, scale)
            delta = lines.difference(p.rho, p.theta, o.rho, o.theta)
            if lines.in_box(*delta, s):
                near.append((o.pair.weight * lines.gaussian(*delta, s), o, s))
        near.sort(key=lambda entry: -entry[0])  # stable: the first in order wins a tie

        truth, uncertain = 0.0, 0.0
        if len(near) >= 1:
            truth = (1.0 - p_false) * near[0][0]
        if len(near) >= 2:
            (_, o1, s), (_, o2, _) = near[:2]
            if all(in_gate(pair, o.pair, p_gate, sigma) for o in (o1, o2)):
                weight = min(o1.pair.weight, o2.pair.weight)
                mu = uncertain_membership(p, o1, o2, origin, s)
                uncertain = (1.0 - p_false) * weight * mu
        vote = 0.0
        best = max(truth, uncertain)
        if best > falsity:
            vote = pair.weight * best / (truth + uncertain + falsity)
        kernel = near[0][1] if near else None
        members.append(p._replace(T=truth, I=uncertain, vote=vote, kernel=kernel))
    return members


def votes(
    scan, origin, eps_rho, eps_theta, p_false, lambda_k, p_gate, sigma,
    v_min, v_max, share_measurement, scale, first_interval_votes, landing,
):  # fmt: skip
    """Return the votes (ρ, θ, weight) of equations 23 and 31.

    First one for each pair, in the pairs' order (weight 0 where there is none); then, landing in
    the kernel's cell too, one at o1 for each pair of interval 2 and later that votes.
    """
    assert landing in ("own_cell", "own_and_kernel_cell", "spread"), landing
    members = memberships(
        scan, origin, eps_rho, eps_theta, p_false, lambda_k, p_gate, sigma,
        v_min, v_max, share_measurement, scale, first_interval_votes,
    )  # fmt: skip
    cast = [(p.rho, p.theta, p.vote) for p in members]
    if landing == "own_and_kernel_cell":
        for p in members:
            if p.kernel is not None and p.vote > 0.0:
                cast.append((p.kernel.rho, p.kernel.theta, p.vote))
    return cast


def spread_scales(members, eps_rho, eps_theta, scale):
    """Return S [Q, 2, 2] of the spread votes of `members`, each in its own representation."""
    assert scale in ("tolerance", "covariance"), scale
    if scale == "covariance":
        return np.array([q.covariance for q in members])
    return np.array([lines.tolerance_scale(eps_rho, eps_theta) for _ in members])
