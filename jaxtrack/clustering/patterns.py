"""What fuzzy ISODATA does to patterns: combination, deletion and division, each a masked operation.

Patterns live in a fixed number of slots, K of which are active.
"""

from typing import NamedTuple

import jax
import jax.numpy as jnp

from jaxtrack.numerics.safe import safe_sqrt
from jaxtrack.types import Array


class IsodataParams(NamedTuple):
    """Parameters of fuzzy ISODATA. Traced; the samples' features are in comparable units."""

    fuzzifier: Array | float = 1.6  # m > 1
    merge_exponent: Array | float = 0.5  # α_c: patterns nearer than D (1 − K^−α_c) merge
    split_exponent: Array | float = 1.0  # γ: G = K^−γ, as printed; below 0 it increases with K
    split_step: Array | float = 0.5  # λ_d, in standard deviations of the pattern
    membership_floor: Array | float = 0.5  # θ: samples above it are a pattern's own
    aggregation_gate: Array | float = 0.8  # A: patterns that hold their own below it are loose
    delete_share: Array | float = 0.03  # δ, of an even share of the samples


class Partition(NamedTuple):
    """What divisions and deletions are decided by."""

    spread: Array  # [K, D] S_ij
    spread_gate: Array  # [D] F_std
    aggregation: Array  # [K] C_i
    count: Array  # [K] T_i


def merge(
    centres: Array, active: Array, mass: Array, *, merge_exponent: Array | float
) -> tuple[Array, Array]:
    """Combine patterns nearer to each other than M_ind, the closest pair first.

        Z* = (M_i Z_i + M_j Z_j) / (M_i + M_j),   M_i = Σ_j w_j μ_ij,   M_ind = D (1 − K^(−α_c))

    with D the mean distance of the K centres from each other. The new centre, in the lower slot,
    may be combined again. Centres that coincide up to rounding are one pattern whatever M_ind.

    Args:
        centres: [K, D].
        active: [K].
        mass: [K] M_i.
        merge_exponent: α_c.

    Returns:
        Centres and active mask.

    Example:
        >>> centres = jnp.array([[0.0], [1.0], [10.0]])
        >>> mass = jnp.array([3.0, 1.0, 2.0])
        >>> print(*merge(centres, jnp.ones(3, bool), mass, merge_exponent=0.5))
        [[ 0.25]
         [ 1.  ]
         [10.  ]] [ True False  True]

    Source: clustering-statistic Hough transform (2018), equations 24–26.
    """
    slots, dtype = centres.shape[0], centres.dtype
    upper = jnp.triu(jnp.ones((slots, slots), bool), 1)

    def distances(centres: Array, active: Array) -> tuple[Array, Array]:
        clean = jnp.where(active[:, None], centres, 0.0)
        square = ((clean[:, None] - clean[None, :]) ** 2).sum(-1)
        return jnp.sqrt(square), upper & active[:, None] & active[None, :]

    apart, pair = distances(centres, active)
    pairs = pair.sum().astype(dtype)
    patterns = jnp.maximum(active.sum(), 1).astype(dtype)
    mean = jnp.where(pair, apart, 0.0).sum() / jnp.maximum(pairs, 1.0)
    gate = mean * (1 - patterns ** -jnp.asarray(merge_exponent, dtype))

    def combine(_: Array, state: tuple[Array, Array, Array]) -> tuple[Array, Array, Array]:
        centres, active, mass = state
        apart, pair = distances(centres, active)
        apart = jnp.where(pair, apart, jnp.inf).ravel()
        closest = jnp.argmin(apart)
        order = jnp.arange(slots)
        first, second = order == closest // slots, order == closest % slots
        read = lambda x, at: jnp.where(at, x, 0.0).sum()
        rounding = 45 * jnp.finfo(dtype).eps * jnp.sqrt(read((centres**2).sum(-1), first))
        near = (apart[closest] < gate) | (apart[closest] <= rounding)
        mass_1, mass_2 = read(mass, first), read(mass, second)
        total = mass_1 + mass_2
        # Patterns without any sample count alike.
        share = jnp.where(total > 0, mass_1 / jnp.where(total > 0, total, 1.0), 0.5)
        weight = jnp.where(first, share, 0.0) + jnp.where(second, 1 - share, 0.0)
        joint = (weight[:, None] * centres).sum(0)
        centres = jnp.where((near & first)[:, None], joint[None, :], centres)
        mass = jnp.where(near & first, total, mass)
        return centres, active & ~(near & second), mass

    clean = jnp.where(active[:, None], centres, 0.0)
    merged, left, _ = jax.lax.fori_loop(0, slots - 1, combine, (clean, active, mass))
    return jnp.where(active[:, None], merged, centres), left


def partition(
    samples: Array,
    weights: Array,
    centres: Array,
    active: Array,
    membership: Array,
    *,
    params: IsodataParams,
) -> Partition:
    """Return the fuzzy standard deviations and aggregation degrees of the patterns.

        S_ij² = Σ_k w_k μ_ik (x_kj − z_ij)² / (N − 1),     F_std,j = mean_i S_ij (1 + K^(−γ))
        T_i = Σ_k w_k [μ_ik > θ],     C_i = Σ_k w_k [μ_ik > θ] μ_ik / T_i,     N = Σ_k w_k

    Args:
        samples: [N, D].
        weights: [N] ≥ 0, 0 for what is masked.
        centres: [K, D].
        active: [K].
        membership: [K, N].
        params: γ and θ.

    Example:
        >>> samples, one = jnp.array([[0.0], [2.0], [4.0]]), jnp.ones((1, 3))
        >>> params = IsodataParams()
        >>> print(partition(samples, one[0], jnp.array([[2.0]]), jnp.ones(1, bool), one,
        ...                 params=params).spread)
        [[2.]]

    Source: clustering-statistic Hough transform (2018), equations 27–33.

    Note:
        S is averaged feature by feature, for features have units of their own. With N ≤ 1 the
        spread is 0, with T_i = 0 the aggregation degree.
    """
    dtype = samples.dtype
    total = weights.sum()
    share = weights[None, :] * membership
    square = jnp.stack(
        [
            (share * (x[None, :] - z[:, None]) ** 2).sum(-1)
            for x, z in zip(samples.T, centres.T, strict=True)
        ],
        axis=-1,
    )
    many = total > 1
    spread = safe_sqrt(jnp.where(many, square / jnp.where(many, total - 1, 1.0), 0.0))
    spread = jnp.where(active[:, None], spread, 0.0)
    patterns = jnp.maximum(active.sum(), 1).astype(dtype)
    increase = 1 + patterns ** -jnp.asarray(params.split_exponent, dtype)
    own = membership > jnp.asarray(params.membership_floor, dtype)
    count = jnp.where(own & active[:, None], weights[None, :], 0.0).sum(-1)
    held = jnp.where(own & active[:, None], share, 0.0).sum(-1)
    return Partition(
        spread,
        spread.sum(0) / patterns * increase,
        jnp.where(count > 0, held / jnp.where(count > 0, count, 1.0), 0.0),
        count,
    )


def delete(active: Array, total: Array, found: Partition, *, params: IsodataParams) -> Array:
    """Return the active mask without patterns that hold little, or loosely what is not wide.

        T_i ≤ δ N / K    or    C_i ≤ A and S_ij ≤ F_std,j for all j

    Args:
        active: [K].
        total: [] N = Σ w.
        found: the partition.
        params: δ and A.

    Example:
        >>> found = Partition(jnp.zeros((2, 1)), jnp.zeros(1), jnp.array([0.9, 0.9]),
        ...                   jnp.array([9.0, 0.0]))
        >>> print(delete(jnp.ones(2, bool), jnp.array(9.0), found, params=IsodataParams()))
        [ True False]

    Source: clustering-statistic Hough transform (2018), equations 36 and 37.
    """
    dtype = found.count.dtype
    patterns = jnp.maximum(active.sum(), 1).astype(dtype)
    few = found.count <= jnp.asarray(params.delete_share, dtype) * total / patterns
    loose = found.aggregation <= jnp.asarray(params.aggregation_gate, dtype)
    wide = (found.spread > found.spread_gate[None, :]).any(-1)
    return active & ~few & ~(loose & ~wide)


def divide(
    centres: Array, active: Array, found: Partition, *, params: IsodataParams
) -> tuple[Array, Array]:
    """Divide loose, wide patterns in two along their widest feature, as far as slots are free.

        Z± = Z_i ± λ_d S_ij e_j   where   C_i ≤ A,  j = argmax S_ij / F_std,j,  S_ij > F_std,j

    The widest goes first; Z+ stays in its slot, Z− takes the first free one.

    Args:
        centres: [K, D].
        active: [K].
        found: the partition.
        params: A and λ_d.

    Returns:
        Centres and active mask.

    Example:
        >>> found = Partition(jnp.array([[2.0], [0.0]]), jnp.ones(1), jnp.zeros(2), jnp.ones(2))
        >>> print(*divide(jnp.zeros((2, 1)), jnp.array([True, False]), found,
        ...               params=IsodataParams()))
        [[ 1.]
         [-1.]] [ True  True]

    Source: clustering-statistic Hough transform (2018), equations 34 and 35.

    Note:
        Where both features of a pattern are too wide, the second waits for the next round, in
        which the two halves have spreads of their own.
    """
    dtype, slots, features = centres.dtype, *centres.shape
    wide = found.spread > found.spread_gate[None, :]
    gate = jnp.where(wide & (found.spread_gate > 0)[None, :], found.spread_gate[None, :], 1.0)
    excess = jnp.where(wide, found.spread / gate, 0.0)
    loose = found.aggregation <= jnp.asarray(params.aggregation_gate, dtype)
    ready = active & loose & wide.any(-1)
    widest = jnp.argmax(excess, axis=-1)
    along = widest[:, None] == jnp.arange(features)[None, :]
    step = jnp.asarray(params.split_step, dtype) * jnp.where(along, found.spread, 0.0)

    most = jnp.where(ready, excess.max(-1), -1.0)
    order = jnp.arange(slots)
    before = (most[None, :] > most[:, None]) | (
        (most[None, :] == most[:, None]) & (order[None, :] < order[:, None])
    )
    rank = (before & ready[None, :]).sum(-1)
    free_rank = jnp.cumsum(~active) - 1
    child = ready[:, None] & ~active[None, :] & (rank[:, None] == free_rank[None, :])
    parent = child.any(1)
    born = child.any(0)
    clean = jnp.where(active[:, None], centres, 0.0)
    minus = jnp.where(child[:, :, None], (clean - step)[:, None, :], 0.0).sum(0)
    centres = jnp.where(parent[:, None], clean + step, centres)
    return jnp.where(born[:, None], minus, centres), active | born
