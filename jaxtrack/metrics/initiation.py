"""Scores of track initiation: detected lines against the targets' true straight trajectories."""

from typing import Any, NamedTuple

import jax
import jax.numpy as jnp

from jaxtrack.metrics.lines import least_squares_line, line_distance
from jaxtrack.models.line import line_difference
from jaxtrack.numerics.checks import check_array, check_size
from jaxtrack.numerics.masked import masked_max, masked_min, masked_sum
from jaxtrack.numerics.safe import safe_divide, safe_sqrt
from jaxtrack.types import Array, Lines

MAX_DISCRIMINATION = 1e6
"""What `discrimination` is, at most: without any false line it would be infinite."""


class InitiationScores(NamedTuple):
    """How well a set of lines initiates the tracks of K targets."""

    found: Array  # [] int: targets that a line above the gate matches
    false: Array  # [] int: lines above the gate that match no target
    redundant: Array  # [] int: lines above the gate that match a target found already
    perfect: Array  # [] bool: all targets found, nothing false, nothing redundant
    top_k: Array  # [] bool: the K strongest lines match the K targets, whatever the gate
    found_mask: Array  # [K] bool
    rho_error_m: Array  # [K] of the target's strongest line; 0 where not found
    theta_error_rad: Array  # [K] in [−π/2, π/2]; 0 where not found
    weakest_true_votes: Array  # [] whatever the gate; 0 if a target has no line at all
    strongest_false_votes: Array  # [] whatever the gate; 0 if no line is false
    discrimination: Array  # [] the ratio of the two, at most `MAX_DISCRIMINATION`


def initiation_scores(
    lines: Lines,
    truth_position_m: Array,
    truth_mask: Array,
    *,
    match_m: Any,
    gate: Any,
) -> InitiationScores:
    """Score detected lines against true trajectories.

    A line belongs to the target whose true positions are nearest to it, in root mean square over
    the looks, and matches it if that distance is at most `match_m`. So a line matches one target at
    most; of several lines of one target all but one are redundant. A target's own line is the one
    with most votes (then the nearest) that matches it; its errors are taken from the least-squares
    line through the target's true positions, with (ρ, θ) and (−ρ, θ ± π) being the same.

    Args:
        lines: M lines, M ≥ 1, with votes ≥ 0.
        truth_position_m: [K, T, 2] true positions at the looks, K ≥ 1.
        truth_mask: [K] which targets exist; all False is a scene of clutter alone.
        match_m: largest distance at which a line matches a target.
        gate: fewest votes of a line that counts as detected.

    Returns:
        The scores of one realization. Over trials, the root mean square error of ρ is
        sqrt(Σ rho_error_m² / Σ found_mask).

    Raises:
        ValueError: shapes do not fit.
        TypeError: not real numbers.

    Example:
        >>> target = jnp.asarray([[[0.0, 40.0], [100.0, 40.0]]])  # ρ = 40, θ = π/2
        >>> lines = Lines(
        ...     rho_m=jnp.asarray([41.0, 10.0]),
        ...     theta_rad=jnp.full(2, jnp.pi / 2),
        ...     votes=jnp.asarray([8.0, 2.0]),
        ...     mask=jnp.ones(2, bool),
        ... )
        >>> scores = initiation_scores(lines, target, jnp.ones(1, bool), match_m=5.0, gate=3.0)
        >>> bool(scores.perfect), round(float(scores.rho_error_m[0]), 2)
        (True, 1.0)
        >>> float(scores.discrimination)
        4.0

    Source:
        Fan et al., "Neutrosophic Hough Transform-Based Track Initiation Method for Multiple Target
        Tracking" (2018): `discrimination` puts a number to the word of its Table 2.

    Note:
        Ties in votes count against the method: `top_k` asks that no other line have as many votes
        as the weakest target's line. It is true without targets. Votes, ρ and θ carry gradients
        (the matching is held fixed); counts and truth values do not.
    """
    check_array("lines.votes", lines.votes, shape=jnp.shape(lines.mask))
    check_array("truth_position_m", truth_position_m, shape=("K", "T", 2))
    check_array("truth_mask", truth_mask, shape=jnp.shape(truth_position_m)[:1])
    check_array("match_m", match_m, shape=())
    check_array("gate", gate, shape=())
    check_size("number of lines", jnp.size(lines.mask))
    check_size("number of targets", jnp.size(truth_mask))

    dtype = jnp.result_type(lines.rho_m, float)
    exists = jnp.asarray(lines.mask, bool)
    present = jnp.asarray(truth_mask, bool)
    votes = jnp.where(exists, jnp.asarray(lines.votes, dtype), 0.0)
    position_m = jnp.where(present[:, None, None], truth_position_m, 0.0)
    above = exists & (votes >= jnp.asarray(gate, dtype))

    distance_m = jax.lax.stop_gradient(line_distance(lines, position_m))  # [M, K]
    pair = exists[:, None] & present[None, :]
    distance_m = jnp.where(pair, distance_m, jnp.inf)
    nearest = jnp.argmin(distance_m, axis=1)[:, None] == jnp.arange(present.size)[None, :]
    matches = pair & nearest & (distance_m <= jnp.asarray(match_m, distance_m.dtype))
    is_true = jnp.any(matches, axis=1)
    is_false = exists & ~is_true

    targets = jnp.sum(present)
    found_mask = jnp.any(matches & above[:, None], axis=0)
    found = jnp.sum(found_mask)
    false = jnp.sum(above & is_false)
    redundant = jnp.sum(above & is_true) - found

    # Each target's own line: sorted by votes, then by distance, lines that do not match last.
    strength = jnp.where(matches, votes[:, None], -jnp.inf)
    own = jnp.lexsort((distance_m, -strength), axis=0)[0]  # [K]
    own_votes = jnp.where(jnp.any(matches, axis=0), votes[own], 0.0)
    # From the true line, so that the error in ρ has the sign of the true line's name.
    to_truth = line_difference(
        *jax.vmap(least_squares_line)(position_m),
        jnp.where(found_mask, lines.rho_m[own], 0.0),
        jnp.where(found_mask, lines.theta_rad[own], 0.0),
    )
    rho_error_m, theta_error_rad = -to_truth[0], -to_truth[1]

    weakest_true_votes = masked_min(own_votes, present)
    strongest_false_votes = masked_max(votes, is_false)
    floor = weakest_true_votes / MAX_DISCRIMINATION
    discrimination = safe_divide(
        weakest_true_votes, jnp.where(strongest_false_votes > floor, strongest_false_votes, floor)
    )

    all_matched = jnp.all(jnp.any(matches, axis=0) | ~present)
    as_strong = jnp.sum(exists & (votes >= weakest_true_votes))
    return InitiationScores(
        found=found,
        false=false,
        redundant=redundant,
        perfect=(found == targets) & (false == 0) & (redundant == 0),
        top_k=(all_matched & (as_strong == targets)) | (targets == 0),
        found_mask=found_mask,
        rho_error_m=jnp.where(found_mask, rho_error_m, 0.0),
        theta_error_rad=jnp.where(found_mask, theta_error_rad, 0.0),
        weakest_true_votes=weakest_true_votes,
        strongest_false_votes=strongest_false_votes,
        discrimination=discrimination,
    )


def divergence(
    vote_rho_m: Array,
    vote_theta_rad: Array,
    vote_weight: Array,
    true_rho_m: Any,
    true_theta_rad: Any,
    rho_step_m: Any,
    theta_step_rad: Any,
) -> Array:
    """Measure, in cells, how far a target's votes scatter from its true parameter point.

        D² = Σᵥ wᵥ ((Δρᵥ / step_ρ)² + (Δθᵥ / step_θ)²) / Σᵥ wᵥ

    Args:
        vote_rho_m: [V] where the target's votes fell.
        vote_theta_rad: [V]
        vote_weight: [V] ≥ 0; votes of weight 0 may hold anything. No votes at all: D = 0.
        true_rho_m: ρ of the target's line.
        true_theta_rad: its θ; (ρ, θ) and (−ρ, θ ± π) are the same line.
        rho_step_m: the grid's cell.
        theta_step_rad: the grid's cell.

    Raises:
        ValueError: shapes do not fit.
        TypeError: not real numbers.

    Example:
        >>> rho_m, theta_rad = jnp.asarray([103.0, 97.0]), jnp.asarray([0.5, 0.5])
        >>> round(float(divergence(rho_m, theta_rad, jnp.ones(2), 100.0, 0.5, 2.0, 0.01)), 3)
        1.5

    Source:
        Fan et al. (2018), Table 2: a number for the word "divergence".
    """
    check_array("vote_weight", vote_weight, shape=("V",))
    check_array("vote_rho_m", vote_rho_m, shape=jnp.shape(vote_weight))
    check_array("vote_theta_rad", vote_theta_rad, shape=jnp.shape(vote_weight))
    scalars = {
        "true_rho_m": true_rho_m,
        "true_theta_rad": true_theta_rad,
        "rho_step_m": rho_step_m,
        "theta_step_rad": theta_step_rad,
    }
    for name, value in scalars.items():
        check_array(name, value, shape=())

    cast = vote_weight > 0
    rho_m, theta_rad = line_difference(
        jnp.where(cast, vote_rho_m, true_rho_m),
        jnp.where(cast, vote_theta_rad, true_theta_rad),
        true_rho_m,
        true_theta_rad,
    )
    squared_cells = (rho_m / rho_step_m) ** 2 + (theta_rad / theta_step_rad) ** 2
    total = masked_sum(vote_weight * squared_cells, cast)
    return safe_sqrt(safe_divide(total, masked_sum(vote_weight, cast)))


def decline(peak_votes: Any, expected_votes: Any) -> Array:
    """Measure how much of a target's peak is missing: 1 − peak / expected, clipped to [0, 1].

    Args:
        peak_votes: the accumulator's value at the target's peak, any shape.
        expected_votes: its value had every vote of the target fallen into one cell. Where nothing
            is expected, nothing has declined.

    Example:
        >>> float(decline(3.0, 4.0))
        0.25

    Source:
        Fan et al. (2018), Table 2: a number for the word "decline".
    """
    check_array("peak_votes", peak_votes)
    check_array("expected_votes", expected_votes)
    return jnp.clip(1.0 - safe_divide(peak_votes, expected_votes, fallback=1.0), 0.0, 1.0)
