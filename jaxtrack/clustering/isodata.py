"""Fuzzy ISODATA: c-means that finds the number of patterns, by merging, deleting and dividing them.

Patterns live in a fixed number of slots with an active mask; combination, deletion and division are
masked operations in a loop of bounded length. They are decisions, locally constant; the gradient is
that of the c-means at the end.
"""

from typing import NamedTuple

import jax
import jax.numpy as jnp

from jaxtrack.clustering.fuzzy_cmeans import fuzzy_cmeans, memberships, update
from jaxtrack.numerics.checks import check_array, check_size
from jaxtrack.numerics.safe import as_float
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


class IsodataSizes(NamedTuple):
    """Lengths of the loops. Static."""

    rounds: int = 8  # of merging, deleting and dividing, at most; the last does not divide
    updates: int = 3  # iterations of c-means before each
    iterations: int = 100  # of the c-means at the end, at most


class Isodata(NamedTuple):
    """What fuzzy ISODATA found."""

    centres: Array  # [K, D] zero in free slots
    active: Array  # [K] which slots hold a pattern
    membership: Array  # [K, N]
    mass: Array  # [K] Σ_j w_j μ_ij
    aggregation: Array  # [K] C_i: the mean membership of a pattern's own samples
    residual: Array  # [] how far the last update moved any centre
    settled: Array  # [] False: patterns were still changing when the rounds ended


class Partition(NamedTuple):
    """What divisions and deletions are decided by."""

    spread: Array  # [K, D] S_ij
    spread_gate: Array  # [D] F_std
    aggregation: Array  # [K] C_i
    count: Array  # [K] T_i


def farthest_first(samples: Array, weights: Array, *, mask: Array, clusters: int) -> Array:
    """Return indices of samples to start from, [clusters]: heavy ones, far apart.

    The heaviest is taken first, then always the one of largest w d², d its distance to the nearest
    that is taken; −1 where all places are taken already.

    Args:
        samples: [N, D], N ≥ 1.
        weights: [N] ≥ 0.
        mask: [N] which samples exist.
        clusters: how many to take.

    Example:
        >>> samples, weights = jnp.array([[0.0], [1.0], [5.0]]), jnp.array([1.0, 3.0, 1.0])
        >>> print(farthest_first(samples, weights, mask=jnp.ones(3, bool), clusters=4))
        [ 1  2  0 -1]
    """
    clean = jnp.where(mask[:, None], samples, 0.0)
    weights = jnp.where(mask, weights, 0.0)
    far = jnp.full(weights.shape, jnp.inf, weights.dtype)
    taken = []
    for _ in range(clusters):
        score = weights if not taken else weights * far
        best = jnp.argmax(score)
        taken.append(jnp.where(score[best] > 0, best, -1))
        square = ((clean - clean[best][None, :]) ** 2).sum(-1)
        far = jnp.minimum(far, square)
    return jnp.stack(taken)


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
        joint = (jnp.where(weight > 0, weight, 0.0)[:, None] * centres).sum(0)
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
    spread = jnp.sqrt(jnp.where(many, square / jnp.where(many, total - 1, 1.0), 0.0))
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


def isodata(
    samples: Array,
    weights: Array,
    centres: Array,
    *,
    mask: Array | None = None,
    active: Array | None = None,
    params: IsodataParams | None = None,
    tolerance: Array | float = 1e-6,
    sizes: IsodataSizes | None = None,
) -> Isodata:
    """Return the patterns of weighted samples by fuzzy ISODATA.

    A round is some iterations of c-means, then combination, then deletion and division by the
    partition that is left. Rounds end when one of them changes no pattern; then c-means is iterated
    to its fixed point, which carries the gradient.

    Args:
        samples: [N, D] in units in which the features compare.
        weights: [N] ≥ 0; a sample of weight w counts as w samples.
        centres: [K, D] where to start; K is also the largest number of patterns.
        mask: [N] which samples exist; all by default.
        active: [K] which of the centres exist; all by default.
        params: parameters; the defaults if None.
        tolerance: the c-means at the end ends when no centre moves farther.
        sizes: lengths of the loops; the defaults if None.

    Raises:
        ValueError: shapes do not fit, or a size is too small.
        TypeError: not real numbers, or a size is not an int.

    Example:
        >>> samples = jnp.array([[0.0], [1.0], [10.0], [11.0]])
        >>> found = isodata(samples, jnp.ones(4), jnp.array([[0.0], [1.0], [10.0]]))
        >>> print(found.active.sum(), found.centres.round(1).ravel())
        2 [ 0.5  0.  10.5]

    Source: clustering-statistic Hough transform (2018), equations 20–37.
    """
    params = IsodataParams() if params is None else params
    sizes = IsodataSizes() if sizes is None else sizes
    check_array("samples", samples, shape=("N", "D"))
    check_array("weights", weights, shape=(samples.shape[0],))
    check_array("centres", centres, shape=("K", samples.shape[1]))
    for name, value in zip(sizes._fields, sizes, strict=True):
        check_size(f"sizes.{name}", value, at_least=1)
    samples = as_float(samples)
    dtype = samples.dtype
    mask = jnp.ones(samples.shape[0], bool) if mask is None else jnp.asarray(mask)
    active = jnp.ones(centres.shape[0], bool) if active is None else jnp.asarray(active)
    check_array("mask", mask, shape=(samples.shape[0],))
    check_array("active", active, shape=(centres.shape[0],))
    samples = jnp.where(mask[:, None], samples, 0.0)
    weights = jnp.where(mask, jnp.asarray(weights, dtype), 0.0)
    centres = jnp.where(active[:, None], jnp.asarray(centres, dtype), 0.0)

    frozen = jax.lax.stop_gradient((samples, weights, centres, params))
    start, active, settled = _decide(*frozen[:3], active, frozen[3], sizes)
    found = fuzzy_cmeans(
        samples,
        weights,
        jnp.where(active[:, None], start, 0.0),
        mask=mask,
        active=active,
        fuzzifier=params.fuzzifier,
        tolerance=tolerance,
        iterations=sizes.iterations,
    )
    last = partition(samples, weights, found.centres, active, found.membership, params=params)
    mass = (weights[None, :] * found.membership).sum(-1)
    return Isodata(
        found.centres, active, found.membership, mass, last.aggregation, found.residual, settled
    )


def _decide(
    samples: Array,
    weights: Array,
    centres: Array,
    active: Array,
    params: IsodataParams,
    sizes: IsodataSizes,
) -> tuple[Array, Array, Array]:
    """Return centres, active mask and whether the patterns came to rest."""
    total, fuzzifier = weights.sum(), params.fuzzifier

    def go_on(state: tuple[Array, Array, Array, Array]) -> Array:
        return (state[0] < sizes.rounds) & ~state[3]

    def go(state: tuple[Array, Array, Array, Array]) -> tuple[Array, Array, Array, Array]:
        turn, centres, active, _ = state
        settle = lambda _, z: update(samples, weights, z, active=active, fuzzifier=fuzzifier)
        before = jax.lax.fori_loop(0, sizes.updates, settle, centres)
        mu = memberships(samples, before, active=active, fuzzifier=fuzzifier)
        mass = (weights[None, :] * mu).sum(-1)
        centres, left = merge(before, active, mass, merge_exponent=params.merge_exponent)
        mu = memberships(samples, centres, active=left, fuzzifier=fuzzifier)
        found = partition(samples, weights, centres, left, mu, params=params)
        left = delete(left, total, found, params=params)
        divided, more = divide(centres, left, found, params=params)
        last = turn == sizes.rounds - 1
        centres = jnp.where(last, centres, divided)
        left = jnp.where(last, left, more)
        same = (left == active).all() & ((centres == before) | ~active[:, None]).all()
        return turn + 1, centres, left, same

    begin = jnp.asarray(0, jnp.int32), centres, active, jnp.asarray(False)
    _, centres, active, settled = jax.lax.while_loop(go_on, go, begin)
    return centres, active, settled
