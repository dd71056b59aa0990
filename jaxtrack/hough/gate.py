"""Gates from a stated false-track rate: there is no universal gate.

A right gate depends on the clutter, the noise and on how hard the method searches; a better search
finds higher false maxima too. So it is read off scenes without targets.
"""

import jax.numpy as jnp

from jaxtrack.types import Array


def gate_for_false_rate(votes: Array, mask: Array, false_per_run: Array | float) -> Array:
    """Return the lowest gate that lets no more than so many false lines a run pass.

    Args:
        votes: [R, M] votes or scores of the lines found in R scenes without targets.
        mask: [R, M] which lines exist.
        false_per_run: wanted mean number of lines with votes ≥ gate in such a scene. R should be
            ten times its inverse or more.

    Returns:
        A scalar just above the first vote that has to stay out; 0 where all may pass.

    Example:
        >>> votes = jnp.array([[9.0, 4.0], [5.0, 3.0], [6.0, 2.0], [8.0, 1.0]])
        >>> print(f"{gate_for_false_rate(votes, votes > 0, 0.5):.3f}")
        6.000

    Note:
        With whole votes the rate is met from below: no gate lies between two counts.
    """
    strongest = jnp.sort(jnp.where(mask, votes, 0.0).ravel())[::-1]
    passing = jnp.floor(jnp.asarray(false_per_run, votes.dtype) * votes.shape[0] + 1e-6)
    index = passing.astype(jnp.int32)
    first_out = strongest[jnp.minimum(index, strongest.shape[0] - 1)]
    gate = jnp.nextafter(first_out, jnp.asarray(jnp.inf, votes.dtype))
    return jnp.where((index < strongest.shape[0]) & (first_out > 0), gate, 0.0)
