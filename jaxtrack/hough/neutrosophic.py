"""Neutrosophic Hough transform: a pair votes as far as the interval before speaks for it.

How far it does are the pair's memberships (`neutrosophic_memberships`); here the votes are cast and
their peaks taken.
"""

import jax.numpy as jnp

from jaxtrack.hough.grid import Sizes, check_sizes
from jaxtrack.hough.neutrosophic_memberships import NeutrosophicParams, Rules, memberships, scales
from jaxtrack.hough.pairs import candidate_pairs
from jaxtrack.hough.peaks import HoughInfo, check_extraction, extract, inform
from jaxtrack.hough.votes import VoteKernel, Votes, gaussian, hard, scaled_gaussian, soft
from jaxtrack.numerics.checks import (
    check_choice,
    check_known,
    check_positive,
    check_probability,
    check_scans,
)
from jaxtrack.types import Array, Key, Lines, Scan

LANDINGS = ("own_cell", "own_and_kernel_cell", "spread")
SCALES = ("tolerance", "covariance")


def estimate(
    scans: Scan,
    params: NeutrosophicParams,
    key: Key | None = None,
    *,
    sizes: Sizes,
    rules: Rules = Rules(),  # noqa: B008 - an immutable tuple
) -> tuple[Lines, HoughInfo]:
    """Return the strongest lines of the neutrosophic vote.

    Args:
        scans: K looks stacked.
        params: grid, extractor, speeds, tolerances and rates.
        key: not used; part of every window estimator's signature.
        sizes: static sizes.
        rules: static rules.

    Raises:
        ValueError: an unknown landing or scale, a shape that does not fit, or a known value that
            cannot be.

    Example:
        >>> scans = Scan(jnp.arange(3.0), jnp.ones(3, bool),
        ...              jnp.array([[[0.0, 8.0]], [[200.0, 8.0]], [[450.0, 8.0]]]),
        ...              jnp.ones((3, 1), bool))
        >>> lines, info = estimate(scans, NeutrosophicParams(), sizes=Sizes(lines=1, pairs=4))
        >>> print(f"{lines.votes[0]:.2f} {lines.rho_m[0]:.1f}")
        1.98 8.0

    Source: neutrosophic Hough transform (2018), section IV.
    """
    return _estimate(scans, params, None, sizes=sizes, rules=rules)


def soft_estimate(
    scans: Scan,
    params: NeutrosophicParams,
    temperature: Array,
    key: Key | None = None,
    *,
    sizes: Sizes,
    rules: Rules = Rules(),  # noqa: B008
) -> tuple[Lines, HoughInfo]:
    """Return the lines of `estimate` with soft memberships and, for the cell landings, soft cells.

    Differentiable in detections, weights, tolerances and rates; tends to `estimate` as the
    temperature goes to zero (a vote lands in cells with the tolerances times the temperature).
    """
    return _estimate(scans, params, temperature, sizes=sizes, rules=rules)


def _estimate(
    scans: Scan,
    params: NeutrosophicParams,
    temperature: Array | None,
    *,
    sizes: Sizes,
    rules: Rules,
) -> tuple[Lines, HoughInfo]:
    check_sizes(sizes)
    check_choice("rules.landing", rules.landing, LANDINGS)
    check_choice("rules.scale", rules.scale, SCALES)
    scans = check_scans(scans)
    check_extraction(params.grid, params.peaks)
    dtype = scans.position_m.dtype
    eps_rho = check_positive("params.eps_rho_m", params.eps_rho_m, dtype)
    eps_theta = check_positive("params.eps_theta_rad", params.eps_theta_rad, dtype)
    sigma = check_positive("params.sigma_m", params.sigma_m, dtype)
    p_false = check_probability("params.p_false", params.p_false, dtype)
    p_gate = params.p_gate
    check_known("params.p_gate", p_gate, lambda p: (p >= 0) & (p < 1), "a probability below 1")
    check_known("params.adjustment", params.adjustment, lambda x: x >= 0, "a factor of at least 0")
    params = params._replace(
        eps_rho_m=eps_rho, eps_theta_rad=eps_theta, sigma_m=sigma, p_false=p_false
    )
    if temperature is not None:
        temperature = check_positive("temperature", temperature, dtype)
    grid = params.grid
    origin = jnp.asarray(grid.origin_m, dtype)
    pairs = candidate_pairs(scans, origin, params.speed, pairs=sizes.pairs)
    member = memberships(pairs, params, temperature, sizes=sizes, rules=rules)
    flat = lambda x: x.reshape(-1, *x.shape[2:])
    query = Votes(flat(pairs.rho_m), flat(pairs.theta_rad), flat(member.vote), flat(pairs.mask))
    votes = query
    kernel: VoteKernel
    if rules.landing == "spread" and rules.scale == "covariance":
        own, _ = scales(pairs, params, rules)
        kernel = scaled_gaussian(flat(own), query.mask)
    elif rules.landing == "spread":
        kernel = gaussian(eps_rho, eps_theta)
    elif temperature is None:
        kernel = hard(grid, sizes, dtype)
    else:
        kernel = soft(grid, sizes, temperature * eps_rho, temperature * eps_theta, dtype)
    if rules.landing == "own_and_kernel_cell":
        after = member.vote.at[0].set(0.0)  # the first interval has no kernels
        there = query._replace(
            rho_m=flat(member.kernel_rho_m),
            theta_rad=flat(member.kernel_theta_rad),
            weight=flat(after),
        )
        votes = Votes(*(jnp.concatenate(both) for both in zip(query, there, strict=True)))
    lines = extract(query, votes, kernel, grid, params.peaks, sizes=sizes)
    overflow = pairs.overflow.any() | member.overflow
    return lines, inform(lines, scans, params.peaks, overflow, votes)
