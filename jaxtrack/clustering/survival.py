"""How far a pattern of fuzzy ISODATA withstands combination and deletion: their smooth form."""

import jax
import jax.numpy as jnp

from jaxtrack.clustering.patterns import IsodataParams, partition
from jaxtrack.numerics.safe import safe_divide, safe_norm
from jaxtrack.types import Array


def survival(
    samples: Array,
    weights: Array,
    centres: Array,
    active: Array,
    membership: Array,
    width: Array | float,
    *,
    params: IsodataParams,
) -> Array:
    """Return the share by which each pattern withstands `merge` and `delete`, smoothly.

        own_ik = σ((μ_ik − θ)/w),    T_i = Σ_k w_k own_ik,    C_i = Σ_k w_k own_ik μ_ik / T_i
        few    = σ((1 − T_i K / (δ N))/w)
        loose  = σ((A − C_i)/w) Π_j σ((1 − S_ij / F_std,j)/w)
        near   = 1 − Π_{l heavier than i} σ((d_il − M_ind)/(w D))
        share  = (1 − few)(1 − loose)(1 − near)

    As the width vanishes it is 1 for a pattern that would stay, and 0 for one that would be deleted
    or fall to a heavier one.

    Args:
        samples: [N, D].
        weights: [N] ≥ 0, 0 for what is masked.
        centres: [K, D].
        active: [K].
        membership: [K, N].
        width: w > 0 of the sigmoids.
        params: α_c, θ, A and δ.

    Returns:
        [K], 0 in free slots.

    Example:
        >>> samples, centres = jnp.array([[0.0], [0.1], [9.0]]), jnp.array([[0.05], [9.0]])
        >>> membership = jnp.array([[1.0, 1.0, 0.0], [0.0, 0.0, 1.0]])
        >>> weights, active = jnp.array([9.0, 9.0, 0.1]), jnp.ones(2, bool)
        >>> print(survival(samples, weights, centres, active, membership, 0.01,
        ...                params=IsodataParams()).round(2))
        [1. 0.]

    Source: clustering-statistic Hough transform (2018), equations 24–26, 30–33, 36 and 37; the
        smooth form is this library's.
    """
    dtype = samples.dtype
    number = lambda x: jnp.asarray(x, dtype)
    above = lambda x: jax.nn.sigmoid(x / number(width))
    there = active[:, None]
    own = jnp.where(
        there, weights[None, :] * above(membership - number(params.membership_floor)), 0
    )
    count = own.sum(-1)
    aggregation = safe_divide((own * membership).sum(-1), count)
    patterns = jnp.where(active.any(), active.sum(), 1).astype(dtype)
    even = number(params.delete_share) * weights.sum() / patterns
    few = above(1 - safe_divide(count, even))

    found = partition(samples, weights, centres, active, membership, params=params)
    excess = safe_divide(found.spread, found.spread_gate[None, :])
    narrow = above(1 - excess).prod(-1)
    loose = above(number(params.aggregation_gate) - aggregation) * narrow

    clean = jnp.where(there, centres, 0.0)
    apart = safe_norm(clean[:, None] - clean[None, :])
    order = jnp.arange(len(active))
    pair = there & active[None, :] & (order[:, None] != order[None, :])
    mean = safe_divide(jnp.where(pair, apart, 0.0).sum(), pair.sum().astype(dtype))
    least = mean * (1 - patterns ** -number(params.merge_exponent))
    mass = jax.lax.stop_gradient((weights[None, :] * membership).sum(-1))
    heavier = (mass[None, :] > mass[:, None]) | (
        (mass[None, :] == mass[:, None]) & (order[None, :] < order[:, None])
    )
    free = jnp.where(pair & heavier, above(safe_divide(apart - least, mean)), 1.0).prod(-1)
    return jnp.where(active, (1 - few) * (1 - loose) * free, 0.0)
