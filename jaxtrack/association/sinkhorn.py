"""A soft assignment of detections to tracks by Sinkhorn's scaling, between chance and optimum.

Of all tables of shares whose rows add up to one, misses included, and whose columns to one at most,
it takes

    argmax Σ_ij p_ij log w_ij + Σ_j p_0j log w_0j + τ H(p)

With τ towards zero that is the optimal assignment, with any τ a smooth function of the weights
wherever no column is just full. A track whose detections nobody else wants has, with τ = 1, the
probabilities of PDA.
"""

import jax
import jax.numpy as jnp

from jaxtrack.association import pda
from jaxtrack.association.gating import Association, AssociationParams, Predicted
from jaxtrack.association.ratios import from_marginals, likelihood_ratios
from jaxtrack.numerics.checks import check_array, check_positive, check_size
from jaxtrack.numerics.masked import masked_logsumexp
from jaxtrack.types import Array, Key, Scan


def marginals(
    likelihood_ratio: Array,
    miss: Array,
    *,
    temperature: Array | float = 1.0,
    iterations: int = 50,
) -> Array:
    """Return the share of each detection, and last of the miss, for each track: [T, M + 1].

        p_ij = a_j w_ij^(1/τ) b_i,    a_j = 1 / (w_0j^(1/τ) + Σ_i w_ij^(1/τ) b_i),
        b_i = min(1, 1 / Σ_j a_j w_ij^(1/τ))

    in turn, in logarithms, and a once more at the end: rows add up to one exactly, columns exceed
    one by what is left to converge.

    Args:
        likelihood_ratio: [T, M] w ≥ 0; zero for pairs that may not be.
        miss: [T] w_0, at least 1e-12 counts.
        temperature: τ > 0.
        iterations: so many; of the order of the logarithms' spread over τ, to converge. Static.

    Raises:
        ValueError: shapes do not fit, or a temperature that cannot be.
        TypeError: not real numbers, or `iterations` is not an int.

    Example:
        >>> ratio = jnp.array([[8.0, 0.0], [4.0, 2.0]])
        >>> print((100 * marginals(ratio, jnp.ones(2))).round())
        [[71.  0. 29.]
         [29. 47. 24.]]
        >>> print((100 * marginals(ratio, jnp.ones(2), temperature=0.1)).round())
        [[100.   0.   0.]
         [  3.  97.   0.]]

    Source: M. Cuturi, "Sinkhorn distances: lightspeed computation of optimal transport", 2013, with
        columns that need not be full.

    Note:
        The gradient in a weight that is zero is zero.
    """
    return _scaled(likelihood_ratio, miss, temperature, iterations)[0]


def associate(
    predicted: Predicted,
    scan: Scan,
    params: AssociationParams,
    key: Key | None = None,
    *,
    temperature: Array | float = 1.0,
    iterations: int = 50,
) -> Association:
    """Associate all tracks jointly and softly: `Associator(sinkhorn.associate, update_mixture)`.

    Args:
        predicted: T tracks, any number.
        scan: one look of M detections.
        params: detection probability, clutter density and gate.
        key: not used.
        temperature: τ > 0; towards zero the most likely assignment.
        iterations: so many. Static.

    Returns:
        The association; it counts as converged where the last iteration moved no share by more
        than 1e-3.

    Raises:
        ValueError: shapes do not fit, or a temperature that cannot be.
        TypeError: not real numbers, or `iterations` is not an int.

    Example:
        >>> predicted = Predicted(jnp.array([[0.0, 0.0], [3.0, 0.0]]), jnp.stack([jnp.eye(2)] * 2),
        ...                       jnp.eye(2), jnp.ones(2, bool))
        >>> places = jnp.array([[1.0, 0.0], [2.0, 0.0]])
        >>> scan = Scan(jnp.array(0.0), jnp.array(True), places, jnp.ones(2, bool))
        >>> one = AssociationParams(0.9, 1e-3)
        >>> print((100 * associate(predicted, scan, one, temperature=0.1).weight).round())
        [[100.   0.]
         [  0. 100.]]
    """
    ratio, miss = likelihood_ratios(predicted, scan, params)
    found, moved = _scaled(ratio, miss, temperature, iterations)
    return from_marginals(found)._replace(converged=moved < 1e-3)


def _scaled(
    ratio: Array, miss: Array, temperature: Array | float, iterations: int
) -> tuple[Array, Array]:
    """Return the shares, and how far the last iteration moved any of them."""
    check_array("likelihood_ratio", ratio, shape=("T", "M"))
    check_array("miss", miss, shape=(ratio.shape[0],))
    check_size("iterations", iterations)
    dtype = jnp.result_type(ratio, float)
    tau = check_positive("temperature", temperature, dtype)
    if ratio.size == 0:  # nothing competes
        return pda.marginals(ratio, miss), jnp.zeros((), dtype)
    there = ratio > 0
    weight = jnp.where(there, jnp.minimum(ratio, jnp.finfo(dtype).max), 1.0)
    log_weight, log_miss = jnp.log(weight) / tau, jnp.log(pda.floored(miss)) / tau

    def rows(log_b: Array) -> Array:
        wanted = masked_logsumexp(log_weight + log_b, there, axis=1)
        return -jnp.logaddexp(log_miss, wanted)

    def go(log_b: Array, _: None) -> tuple[Array, None]:
        full = masked_logsumexp(log_weight + rows(log_b)[:, None], there, axis=0)
        return -jnp.where(full > 0, full, 0.0)[None], None

    def shares(log_b: Array) -> Array:
        log_a = rows(log_b)
        taken = jnp.where(there, jnp.exp(log_weight + log_a[:, None] + log_b), 0.0)
        return jnp.concatenate([taken, jnp.exp(log_miss + log_a)[:, None]], axis=1)

    before, _ = jax.lax.scan(go, jnp.zeros_like(log_weight[:1]), length=iterations - 1)
    after, _ = go(before, None)
    found = shares(after)
    moved = jnp.abs(jax.lax.stop_gradient(found - shares(before))).max(initial=0.0)
    return found, moved
