r"""Exact joint probabilistic data association, by a dynamic programme over subsets of the tracks.

A joint event gives every track one detection or none, and no detection to two tracks. With f[S]
the total weight of the ways in which exactly the tracks S take some of the first i detections,

    f[S] ← f[S] + Σ_{j ∈ S} w_ij f[S \ j],    Z = Σ_S f[S] Π_{j ∉ S} w_0j,
    p_ij = w_ij ∂ log Z / ∂w_ij,

so one pass and its reverse mode give all marginals, in O(M T 2^T) and without a subtraction.
"""

import jax
import jax.numpy as jnp

from jaxtrack.association.gating import (
    Association,
    AssociationParams,
    Predicted,
)
from jaxtrack.association.pda import floored
from jaxtrack.association.ratios import from_marginals, likelihood_ratios
from jaxtrack.numerics.checks import check_array
from jaxtrack.numerics.segments import costly
from jaxtrack.types import Array, Key, Scan

MAX_TRACKS = 10
"""The programme holds 2^T numbers; for more tracks there is `belief_propagation`."""


def marginals(likelihood_ratio: Array, miss: Array) -> Array:
    """Return the probability of each detection, and last of the miss, for each track: [T, M + 1].

    Differentiable to any order, in reverse mode first; to policies of `jax.checkpoint` they are
    "costly". Rows may have any scale, in single precision as well: each is divided by its largest
    weight, and what that does to a subset is put back in logarithms.

    Args:
        likelihood_ratio: [T, M] w ≥ 0; zero for pairs that may not be.
        miss: [T] w_0, at least 1e-12 counts. T at most 10.

    Raises:
        ValueError: shapes do not fit, or there are too many tracks.
        TypeError: not real numbers.

    Example:
        >>> ratio = jnp.array([[8.0, 0.0], [8.0, 1.0]])
        >>> print((100 * marginals(ratio, jnp.ones(2))).round())
        [[62.  0. 38.]
         [31. 35. 35.]]

    Source: T. Fortmann, Y. Bar-Shalom and M. Scheffe, "Sonar tracking of multiple targets using
        joint probabilistic data association", 1983; the subset programme is this library's.
    """
    check_array("likelihood_ratio", likelihood_ratio, shape=("T", "M"))
    tracks = likelihood_ratio.shape[0]
    check_array("miss", miss, shape=(tracks,))
    if tracks > MAX_TRACKS:
        raise ValueError(
            f"likelihood_ratio: got {tracks} tracks, want at most {MAX_TRACKS}; "
            "belief_propagation.marginals takes more"
        )
    dtype = jnp.result_type(likelihood_ratio, float)
    # Its reciprocal is still a number of full precision.
    weight = jnp.minimum(likelihood_ratio, jnp.finfo(dtype).max / 1024)
    largest = jax.lax.stop_gradient(jnp.max(weight, axis=1, initial=0.0))
    scale = jnp.where(largest > jnp.finfo(dtype).tiny, largest, 1.0)
    weight = weight / scale[:, None]
    log_miss = jnp.log(floored(miss)) - jnp.log(scale)
    per_weight, missed = (costly(x) for x in _slopes(weight, log_miss))
    return jnp.concatenate([weight * per_weight, missed[:, None]], axis=1)


def associate(
    predicted: Predicted, scan: Scan, params: AssociationParams, key: Key | None = None
) -> Association:
    """Associate all tracks jointly (JPDA).

    Args:
        predicted: T tracks, at most 10.
        scan: one look of M detections.
        params: detection probability, clutter density and gate.
        key: not used.

    Raises:
        ValueError: shapes do not fit, or there are too many tracks.
        TypeError: not real numbers.

    Example:
        >>> predicted = Predicted(jnp.array([[0.0, 0.0], [3.0, 0.0]]), jnp.stack([jnp.eye(2)] * 2),
        ...                       jnp.eye(2), jnp.ones(2, bool))
        >>> places = jnp.array([[1.0, 0.0], [2.0, 0.0]])
        >>> scan = Scan(jnp.array(0.0), jnp.array(True), places, jnp.ones(2, bool))
        >>> print((100 * associate(predicted, scan, AssociationParams(0.9, 1e-3)).weight).round())
        [[82. 18.]
         [18. 82.]]
    """
    return from_marginals(marginals(*likelihood_ratios(predicted, scan, params)))


def _both(weight: Array, log_miss: Array) -> tuple[Array, Array]:
    return jax.grad(_log_total, (0, 1))(weight, log_miss)


@jax.custom_vjp
def _slopes(weight: Array, log_miss: Array) -> tuple[Array, Array]:
    """Return ∂ log Z / ∂w and ∂ log Z / ∂ log w_0, which is the probability of the miss."""
    return _both(weight, log_miss)


def _slopes_forward(
    weight: Array, log_miss: Array
) -> tuple[tuple[Array, Array], tuple[Array, Array]]:
    return _both(weight, log_miss), (weight, log_miss)


def _slopes_backward(at: tuple[Array, Array], along: tuple[Array, Array]) -> tuple[Array, Array]:
    # Second derivatives are symmetric: what comes back is what goes forth, and going forth needs
    # neither the programme's steps in memory nor their reverse mode twice.
    return jax.jvp(_both, at, along)[1]


_slopes.defvjp(_slopes_forward, _slopes_backward)


def _log_total(weight: Array, log_miss: Array) -> Array:
    """Return log Z of weights of at most 1; misses of any size stand in their logarithms."""
    tracks, dtype = weight.shape[0], weight.dtype

    def absorb(f: Array, ratio: Array) -> tuple[Array, None]:
        after = f
        for j in range(tracks):
            # Three axes, not T: the fewer, the faster the compiler's loops.
            without = f.reshape(2**j, 2, -1)[:, :1] * ratio[j]
            after = after + jnp.pad(without, ((0, 0), (1, 0), (0, 0))).reshape(-1)
        return after, None

    nothing_yet = jnp.zeros(2**tracks, dtype).at[0].set(1)
    # Its parts are in f: what is kept of a detection for the way back is f alone.
    f, _ = jax.lax.scan(jax.checkpoint(absorb, prevent_cse=False), nothing_yet, weight.T)
    others = _over_others(log_miss).reshape(-1)
    peak = jax.lax.stop_gradient(jnp.where(f > 0, others, -jnp.inf).max())
    # Where no event leads f is zero, but weights that are zero have a gradient: a bound far above
    # every event keeps it, and keeps it finite.
    bound = jnp.where(others < peak + 60, others - peak, 60.0)
    return peak + jnp.log((f * jnp.exp(bound)).sum())


def _over_others(log_miss: Array) -> Array:
    """Return Σ_{j ∉ S} log w_0j for all subsets, shape (2,) * T."""
    tracks = log_miss.shape[0]
    total = jnp.zeros((2,) * tracks, log_miss.dtype)
    for j in range(tracks):
        shape = tuple(2 if axis == j else 1 for axis in range(tracks))
        total = total + jnp.stack([log_miss[j], jnp.zeros_like(log_miss[j])]).reshape(shape)
    return total
