"""The table of tracks that an initiator returns."""

import jax.numpy as jnp

from jaxtrack.types import Array, Stage, Tracks


def tentative_tracks(
    time_s: Array,
    mean: Array,
    covariance: Array,
    keep: Array,
    *,
    existence: Array,
    log_score: Array,
) -> Tracks:
    """Return tentative tracks in the slots that are kept, zeros in the others.

    Args:
        time_s: [] of the states.
        mean: [M, 4].
        covariance: [M, 4, 4].
        keep: [M] which slots hold a track.
        existence: [M].
        log_score: [M].

    Example:
        >>> keep, score = jnp.array([True, False]), jnp.array([9.0, 2.0])
        >>> tracks = tentative_tracks(score[0], jnp.ones((2, 4)), jnp.ones((2, 4, 4)), keep,
        ...                           existence=score, log_score=score)
        >>> print(tracks.identity, tracks.stage, tracks.log_score)
        [ 0 -1] [1 0] [9. 0.]
    """
    clear = lambda x: jnp.where(keep.reshape(-1, *(1,) * (x.ndim - 1)), x, 0)
    return Tracks(
        time_s=time_s,
        mean=clear(mean),
        covariance=clear(covariance),
        mask=keep,
        identity=jnp.where(keep, jnp.arange(keep.shape[0]), -1),
        stage=jnp.where(keep, Stage.TENTATIVE, Stage.EMPTY),
        existence=clear(existence),
        log_score=clear(log_score),
    )
