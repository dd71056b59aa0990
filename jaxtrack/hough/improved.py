"""Improved Hough transform: only pairs with an admissible speed vote."""

from typing import NamedTuple

from jaxtrack.hough.grid import Grid, Sizes
from jaxtrack.hough.modified import vote_once
from jaxtrack.hough.pairs import SpeedGate
from jaxtrack.hough.peaks import HoughInfo, Peaks
from jaxtrack.types import Array, Key, Lines, Scan


class ImprovedParams(NamedTuple):
    """Parameters of the improved Hough transform."""

    grid: Grid = Grid()
    peaks: Peaks = Peaks()
    speed: SpeedGate = SpeedGate()


def estimate(
    scans: Scan, params: ImprovedParams, key: Key | None = None, *, sizes: Sizes
) -> tuple[Lines, HoughInfo]:
    """Return the strongest lines among the cells that pairs of admissible speed vote for.

        v_min ≤ d(z_{k−1,i}, z_{k,j}) / (t_k − t_{k−1}) ≤ v_max

    Args:
        scans: K looks stacked.
        params: grid, extractor and admissible speeds.
        key: not used; part of every window estimator's signature.
        sizes: static sizes.

    Example:
        >>> import jax.numpy as jnp
        >>> scans = Scan(jnp.arange(3.0), jnp.ones(3, bool),
        ...              jnp.array([[[0.0, 8.0]], [[200.0, 8.0]], [[450.0, 8.0]]]),
        ...              jnp.ones((3, 1), bool))
        >>> lines, info = estimate(scans, ImprovedParams(), sizes=Sizes(lines=1, pairs=4))
        >>> print(lines.votes, lines.rho_m)
        [2.] [8.]

    Source: neutrosophic Hough transform (2018), equation 20 (the paper's "IHT").
    """
    return vote_once(scans, params.grid, params.peaks, params.speed, None, sizes=sizes)


def soft_estimate(
    scans: Scan,
    params: ImprovedParams,
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
        scans, params.grid, params.peaks, params.speed, (eps_rho_m, eps_theta_rad), sizes=sizes
    )
