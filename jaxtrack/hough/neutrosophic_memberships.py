"""How far the pairs of the interval before speak for a pair: true, uncertain and false memberships.

The pairs of the interval before are the kernels. Near one of them a pair has a true membership T,
near the line halfway between two of them an uncertain one I, and F = λ_k P_F speaks for clutter.
The pair votes with the largest of the normalised three, and not at all where F is the largest.
"""

from collections.abc import Callable
from typing import NamedTuple

import jax
import jax.numpy as jnp

from jaxtrack.hough.grid import Grid, Sizes
from jaxtrack.hough.pairs import Pairs, SpeedGate, pair_covariances
from jaxtrack.hough.peaks import Peaks
from jaxtrack.hough.votes import correlated_gaussian
from jaxtrack.models.line import line_difference, line_through, wrap_line
from jaxtrack.numerics.choice import choose, greater, step
from jaxtrack.numerics.safe import safe_divide, safe_sqrt
from jaxtrack.types import Array


class NeutrosophicParams(NamedTuple):
    """Parameters of the neutrosophic Hough transform, with the paper's values. Traced."""

    grid: Grid = Grid()
    peaks: Peaks = Peaks()
    speed: SpeedGate = SpeedGate()
    eps_rho_m: Array | float = 20.0  # tolerance along ρ
    eps_theta_rad: Array | float = 0.004  # tolerance along θ
    p_false: Array | float = 0.01  # P_F, the sensor's false alarm rate
    adjustment: Array | float = 1.0  # λ_k
    p_gate: Array | float = 0.99  # P_G of the association gates
    sigma_m: Array | float = 10.0  # noise of a detection, for gates and covariances


class Rules(NamedTuple):
    """What the paper leaves open. Static."""

    landing: str = "spread"  # where a vote counts: own_cell, own_and_kernel_cell or spread
    scale: str = "tolerance"  # memberships by the two tolerances, or by each pair's covariance
    share_measurement: bool = True  # a kernel must end in the detection that the pair begins with
    first_interval_votes: bool = True  # whether pairs without an interval before them vote


class Memberships(NamedTuple):
    """Every pair's memberships before normalisation, its vote and its best kernel; all [K-1, P]."""

    true: Array
    uncertain: Array
    false: Array
    vote: Array
    kernel_rho_m: Array
    kernel_theta_rad: Array
    overflow: Array  # [] a detection had more kernels than `sizes.predecessors`


def memberships(
    pairs: Pairs,
    params: NeutrosophicParams,
    temperature: Array | None = None,
    *,
    sizes: Sizes,
    rules: Rules,
) -> Memberships:
    """Return T, I, F and the vote of every pair.

        μ(p, o) = exp(−Δρ²/2ε_ρ² − Δθ²/2ε_θ²)  in the box |Δρ| ≤ 2ε_ρ, |Δθ| ≤ 2ε_θ
        T = (1 − P_F) max_o w_o μ(p, o),   F = λ_k P_F,   T' + I' + F' = 1
        vote = max(T', I')  where it exceeds F', else 0

    Args:
        pairs: candidate pairs, ρ from the grid's origin.
        params: tolerances and rates.
        temperature: None for the hard memberships; else maxima become softmax-weighted means, and
            boxes, gates and the decision against F sigmoids of this width.
        sizes: `predecessors` bounds the kernels of a pair that share its detection.
        rules: static rules.

    Source: neutrosophic Hough transform (2018), equations 14–19, 24 and 27–30.

    Note:
        Read literally, F normalises to one where no kernel is near, and clutter gets a full vote;
        here F winning means no vote. I is the membership to the line through the midpoints of the
        two best kernels, if the later detection lies in both kernels' association gates.
    """
    number = lambda x: jnp.asarray(x, pairs.rho_m.dtype)
    origin, sure = number(params.grid.origin_m), 1 - number(params.p_false)
    own, kernel = scales(pairs, params, rules)

    def interval(now: Pairs, before: Pairs, own: Array, kernel: Array) -> tuple[Array, ...]:
        index, there, read = _kernels(now, before, sizes, rules)
        theta = read(before.theta_rad)
        other = kernel[:1, None]  # zero for tolerances: nothing is read
        if rules.scale == "covariance":
            # Across the seam a kernel is read as (−ρ, θ ± π), which turns its covariance's sign.
            turned = jnp.abs(now.theta_rad[:, None] - theta) > jnp.pi / 2
            sign = number([1.0, -1.0, 1.0])[None, None, :]
            other = read(kernel) * jnp.where(turned[..., None], sign, 1.0)
        d_rho, d_theta, box, near = _membership(
            (now.rho_m[:, None], now.theta_rad[:, None]),
            (read(before.rho_m), theta),
            own[:, None] + other,
            temperature,
        )
        # Soft alternatives are never left out: a box that underflows would be a step.
        inside = there & (box > 0) if temperature is None else there
        value = jnp.where(inside, read(before.weight) * box * near, 0.0)
        best, left = choose(value, inside, temperature)
        other_than_best = inside & (left > 0) if temperature is None else inside
        second, _ = choose(value * left, other_than_best, temperature)

        ends = [
            [pick(x, index) for pick in (best, second)] for x in (before.first_m, before.second_m)
        ]
        middle = [(a + b) / 2 for a, b in ends]
        apart = (middle[0] != middle[1]).any(-1)
        between = line_through(
            middle[0], jnp.where(apart[:, None], middle[1], middle[0] + 1.0), origin
        )
        scale = own + jnp.stack([best(other[..., c]) for c in range(3)], axis=-1)
        *_, box_between, near_between = _membership(
            (now.rho_m, now.theta_rad), between, scale, temperature
        )
        support = jnp.where(apart, box_between * near_between, 0.0)
        # What the best kernel leaves is no second one by itself, however soft the choice.
        for pick, within, a, b in zip((best, second), (box, box * left), *ends, strict=True):
            times = pick(before.second_s, index), pick(before.dt_s, index)
            gate = _gate(now, a, b, *times, params, temperature)
            support = support * gate * pick(within)
        weights = best(before.weight, index), second(before.weight, index)
        uncertain = sure * jnp.where(weights[0] < weights[1], *weights) * support
        nearest = wrap_line(now.rho_m - best(d_rho), now.theta_rad - best(d_theta))
        return sure * best(value), uncertain, *nearest, (before.count > sizes.predecessors).any()

    now, before = (jax.tree.map(lambda x, s=s: x[s], pairs) for s in (slice(1, None), slice(-1)))
    # A loop, not vmap: its inputs stand in memory, where the compiler would otherwise compute a
    # kernel's line again for every pair that reads it.
    true, uncertain, rho, theta, full = jax.lax.map(
        lambda tables: interval(*tables), (now, before, own[1:], kernel[:-1])
    )
    false = number(params.adjustment) * number(params.p_false)
    total = true + uncertain + false
    largest = safe_divide(greater(true, uncertain, temperature), total)
    vote = largest * step(largest - safe_divide(false, total), temperature) * now.weight
    opening = sure * pairs.weight[:1]
    join = lambda first, rest: jnp.concatenate([first, jnp.where(now.mask, rest, 0.0)])
    return Memberships(
        true=join(jnp.where(pairs.mask[:1], sure, 0.0), true),
        uncertain=join(0 * opening, uncertain),
        false=jnp.full_like(pairs.rho_m, 1.0) * false,
        vote=join(opening if rules.first_interval_votes else 0 * opening, vote),
        kernel_rho_m=join(pairs.rho_m[:1], rho),
        kernel_theta_rad=join(pairs.theta_rad[:1], theta),
        overflow=full.any() if rules.share_measurement else jnp.asarray(False),
    )


def scales(pairs: Pairs, params: NeutrosophicParams, rules: Rules) -> tuple[Array, Array]:
    """Return var ρ, cov and var θ [K-1, P, 3] of pairs as they vote, and as kernels."""
    number = lambda x: jnp.asarray(x, pairs.rho_m.dtype)
    if rules.scale == "covariance":
        covariance = pair_covariances(pairs, number(params.grid.origin_m), number(params.sigma_m))
        both = jnp.stack(covariance, axis=-1)
        return both, both
    zero = jnp.zeros_like(number(0.0))
    eps = [number(params.eps_rho_m) ** 2, zero, number(params.eps_theta_rad) ** 2]
    own = jnp.broadcast_to(jnp.stack(eps), (*pairs.mask.shape, 3))
    return own, jnp.zeros_like(own)


def _kernels(
    now: Pairs, before: Pairs, sizes: Sizes, rules: Rules
) -> tuple[Array, Array, Callable[[Array], Array]]:
    """Return which pairs of the interval before are a pair's kernels [P, E], a mask, a reader.

    The reader takes a table [P, ...] to [P, E, ...]. Kernels that share a detection stand together,
    and slices are read five times as fast as single entries.
    """
    n_pairs = now.mask.shape[0]
    if not rules.share_measurement:
        index = jnp.arange(n_pairs, dtype=jnp.int32)[None, :]
        there = before.mask[None, :] & now.mask[:, None]
        return index, there, lambda x: x[None]
    width = min(sizes.predecessors, n_pairs)
    offset = jnp.arange(width, dtype=jnp.int32)[None, :]
    begin = before.start[now.first]

    def read(x: Array) -> Array:
        padded = jnp.pad(x, ((0, width), *((0, 0),) * (x.ndim - 1)))
        return jax.vmap(lambda at: jax.lax.dynamic_slice_in_dim(padded, at, width))(begin)

    there = (offset < before.count[now.first][:, None]) & now.mask[:, None]
    return jnp.minimum(begin[:, None] + offset, n_pairs - 1), there, read


def _membership(
    line: tuple[Array, Array], other: tuple[Array, Array], scale: Array, temperature: Array | None
) -> tuple[Array, Array, Array, Array]:
    """Return Δρ, Δθ, the box indicator and exp(−½ Δᵀ S⁻¹ Δ), S in the first line's name."""
    d_rho, d_theta = line_difference(*line, *other)
    var_rho, var_theta = scale[..., 0], scale[..., 2]
    near = correlated_gaussian(d_rho, d_theta, scale)
    box = step(2 - jnp.abs(d_rho) / safe_sqrt(var_rho), temperature)
    return (
        d_rho,
        d_theta,
        box * step(2 - jnp.abs(d_theta) / safe_sqrt(var_theta), temperature),
        near,
    )


def _gate(
    now: Pairs,
    a: Array,
    b: Array,
    b_s: Array,
    dt_s: Array,
    params: NeutrosophicParams,
    temperature: Array | None,
) -> Array:
    """Return whether each pair's later detection lies in the association gate of kernel a → b.

    |z − (b + r (b − a))|² ≤ −2 ln(1 − P_G) σ² ((1 + r)² + r² + 1),  r = (t_z − t_b) / (t_b − t_a).
    """
    number = lambda x: jnp.asarray(x, now.rho_m.dtype)
    ratio = safe_divide(now.second_s - b_s, dt_s)
    squared = ((now.second_m - (b + ratio[:, None] * (b - a))) ** 2).sum(-1)
    variance = number(params.sigma_m) ** 2 * ((1 + ratio) ** 2 + ratio**2 + 1)
    limit = -2 * jnp.log1p(-number(params.p_gate)) * variance
    return step(1 - safe_divide(squared, limit), temperature)
