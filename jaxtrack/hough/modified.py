"""Modified Hough transform: every candidate pair votes once, in the cell of its line."""

from typing import NamedTuple

import jax.numpy as jnp

from jaxtrack.hough.grid import Grid, Sizes, check_sizes
from jaxtrack.hough.pairs import Pairs, SpeedGate, candidate_pairs
from jaxtrack.hough.peaks import HoughInfo, Peaks, check_extraction, extract, inform
from jaxtrack.hough.votes import VoteKernel, Votes, hard, soft
from jaxtrack.numerics.checks import check_positive, check_scans
from jaxtrack.types import Array, Key, Lines, Scan


class ModifiedParams(NamedTuple):
    """Parameters of the modified Hough transform."""

    grid: Grid = Grid()
    peaks: Peaks = Peaks()


def pair_votes(pairs: Pairs) -> Votes:
    """Return one vote a pair, at its line, with the product of its detections' weights."""
    return Votes(
        pairs.rho_m.ravel(), pairs.theta_rad.ravel(), pairs.weight.ravel(), pairs.mask.ravel()
    )


def estimate(
    scans: Scan, params: ModifiedParams, key: Key | None = None, *, sizes: Sizes
) -> tuple[Lines, HoughInfo]:
    """Return the strongest lines among the cells that candidate pairs vote for.

    Args:
        scans: K looks stacked.
        params: grid and extractor.
        key: not used; part of every window estimator's signature.
        sizes: static sizes; `pairs` has to hold n_{k−1} · n_k pairs.

    Example:
        >>> scans = Scan(jnp.arange(3.0), jnp.ones(3, bool),
        ...              jnp.array([[[0.0, 8.0]], [[9.0, 8.0]], [[20.0, 8.0]]]), jnp.ones((3, 1), bool))
        >>> lines, info = estimate(scans, ModifiedParams(), sizes=Sizes(lines=1, pairs=4))
        >>> print(lines.votes, lines.rho_m)
        [2.] [8.]

    Source: neutrosophic Hough transform (2018), equations 7–12 (the paper's "MHT").
    """  # noqa: E501
    return vote_once(scans, params.grid, params.peaks, None, None, sizes=sizes)


def soft_estimate(
    scans: Scan,
    params: ModifiedParams,
    eps_rho_m: Array,
    eps_theta_rad: Array,
    key: Key | None = None,
    *,
    sizes: Sizes,
) -> tuple[Lines, HoughInfo]:
    """Return the lines of `estimate` with every vote spread over its neighbourhood.

    Differentiable in detections, weights and tolerances; tends to `estimate` as they vanish.
    """
    return vote_once(
        scans, params.grid, params.peaks, None, (eps_rho_m, eps_theta_rad), sizes=sizes
    )


def vote_once(
    scans: Scan,
    grid: Grid,
    peaks: Peaks,
    speed: SpeedGate | None,
    eps: tuple[Array, Array] | None,
    *,
    sizes: Sizes,
) -> tuple[Lines, HoughInfo]:
    """Let every pair that passes the speed gate vote once; hard without tolerances, else soft."""
    check_sizes(sizes)
    scans = check_scans(scans)
    check_extraction(grid, peaks)
    dtype = scans.position_m.dtype
    pairs = candidate_pairs(scans, jnp.asarray(grid.origin_m, dtype), speed, pairs=sizes.pairs)
    votes = pair_votes(pairs)
    kernel: VoteKernel
    if eps is None:
        kernel = hard(grid, sizes, dtype)
    else:
        eps_rho = check_positive("eps_rho_m", eps[0], dtype)
        eps_theta = check_positive("eps_theta_rad", eps[1], dtype)
        kernel = soft(grid, sizes, eps_rho, eps_theta, dtype)
    lines = extract(votes, votes, kernel, grid, peaks, sizes=sizes)
    return lines, inform(lines, scans, peaks, pairs.overflow.any(), votes)
