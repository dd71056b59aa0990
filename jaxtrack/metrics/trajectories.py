"""From tables of tracks, whose slots are used again, to one trajectory an identity."""

from typing import NamedTuple

import jax.numpy as jnp

from jaxtrack.numerics.checks import check_array, check_size
from jaxtrack.types import Array


class Trajectories(NamedTuple):
    """States of T looks by identity, in I columns."""

    state: Array  # [T, I, D]; zero where there is none
    mask: Array  # [T, I]
    identity: Array  # [I] ascending; −1: empty column
    overflow: Array  # [] there were more identities than columns; those of the highest are left out


def trajectories(state: Array, mask: Array, identity: Array, *, identities: int) -> Trajectories:
    """Lay the tracks of T looks out by their identities.

    Args:
        state: [T, M, D] tables of tracks, or those of their entries that matter; M = 0: no tracks.
        mask: [T, M].
        identity: [T, M] signed integers; what is masked or negative is no track.
        identities: I, how many columns there are, static.

    Raises:
        ValueError: shapes do not fit.
        TypeError: not real numbers, or identities that are not signed integers.

    Example:
        Identity 7 moves from slot 0 to slot 1, and 9 takes its slot:

        >>> state = jnp.array([[[1.0], [0.0]], [[5.0], [2.0]]])
        >>> found = trajectories(state, jnp.array([[True, False], [True, True]]),
        ...                      jnp.array([[7, -1], [9, 7]]), identities=2)
        >>> print(found.identity, found.state[..., 0].tolist(), found.mask.tolist())
        [7 9] [[1.0, 0.0], [2.0, 5.0]] [[True, False], [True, True]]

    Note:
        An identity that stands in a look twice is a tracker's mistake: its first slot counts.
    """
    check_array("state", state, shape=("T", "M", "D"))
    table = jnp.shape(state)[:2]
    check_array("mask", mask, shape=table)
    check_array("identity", identity, shape=table)
    dtype = jnp.result_type(identity)
    if not jnp.issubdtype(dtype, jnp.signedinteger):
        raise TypeError(f"identity: got dtype {dtype}, want signed integers: −1 is nobody's")
    check_size("identities", identities)
    # One more slot, always empty: of no slots there is no first.
    state, mask, identity = (
        jnp.pad(x, ((0, 0), (0, 1)) + ((0, 0),) * (x.ndim - 2))
        for x in (jnp.asarray(state), jnp.asarray(mask, bool), jnp.asarray(identity))
    )
    nobody = jnp.iinfo(dtype).max
    label = jnp.where(mask & (identity >= 0), identity, nobody)
    # Room for one more, and for the label of what is no track, which is the last of all.
    labels = jnp.unique(label, size=identities + 1, fill_value=nobody)
    own = labels[:identities]
    there = own < nobody
    match = (label[:, :, None] == own[None, None, :]) & there[None, None, :]  # [T, M, I]
    slot = jnp.argmax(match, axis=1)
    seen = match.any(axis=1)
    taken = jnp.take_along_axis(state, slot[..., None], axis=1)
    return Trajectories(
        jnp.where(seen[..., None], taken, jnp.zeros((), taken.dtype)),
        seen,
        jnp.where(there, own, -1),
        labels[identities] < nobody,
    )
