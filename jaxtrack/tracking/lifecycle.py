"""The life of tracks in a table of fixed size: admitted, confirmed, coasting, deleted.

A track is tentative when it is admitted. M hits among its last N counted looks confirm it, if its
score is high enough; a confirmed track that misses a look coasts; too many misses in a row delete
it. What counts is for the tracker to say: a look that is not valid, or does not reach the track, is
no miss. Out of the sensor's sight nothing can confirm a tentative track, which goes as if it had
missed; a confirmed one is kept for long, in case it comes back.
"""

import math
from typing import NamedTuple

import jax
import jax.numpy as jnp

from jaxtrack.numerics.checks import check_array, check_known, check_size
from jaxtrack.numerics.segments import decided
from jaxtrack.types import Array, Stage, Tracks


class LifecycleParams(NamedTuple):
    """When tracks are confirmed and deleted. Traced."""

    confirm_hits: Array | int = 3  # M, among the last N counted looks
    confirm_score: Array | float = -math.inf  # and the log score has to be this
    delete_misses: Array | int = 5  # in a row, of a confirmed track
    delete_tentative_misses: Array | int = 2  # valid looks in a row, of a tentative one
    delete_unseen: Array | int = 100  # valid looks in a row without a hit, of any, seen or not


class TrackTable(NamedTuple):
    """Tracks and what their stages depend on."""

    tracks: Tracks
    hit: Array  # [M, N] whether the last N counted looks were hits, the latest last
    misses: Array  # [M] int, in a row
    unseen: Array  # [M] int, valid looks since the last hit, in sight or not
    next_identity: Array  # [] int


class Births(NamedTuple):
    """Candidates for new tracks."""

    mean: Array  # [B, S]
    covariance: Array  # [B, S, S]
    mask: Array  # [B]
    log_score: Array  # [B] where slots are few, the highest are admitted


class Admission(NamedTuple):
    """A table with new tracks in it."""

    table: TrackTable
    full: Array  # [] a candidate found no free slot
    source: Array  # [M] which candidate stands in a slot now; −1: none of them


def check_lifecycle(params: LifecycleParams, looks: int) -> None:
    """Check known numbers of `params.lifecycle`, for a rule of M of N looks.

    Raises:
        ValueError: a number is not a scalar, is below one look, or M is more than N.

    Example:
        >>> check_lifecycle(LifecycleParams(), 5)
    """
    for name, value in params._asdict().items():
        check_array(f"params.lifecycle.{name}", value, shape=())
        if name != "confirm_score":
            check_known(f"params.lifecycle.{name}", value, lambda n: n >= 1, "at least one look")
    want = f"no more than confirm_looks, {looks}"
    check_known("params.lifecycle.confirm_hits", params.confirm_hits, lambda n: n <= looks, want)
    score = params.confirm_score
    check_known("params.lifecycle.confirm_score", score, lambda x: x == x, "a number")


def empty_table(time_s: Array, *, tracks: int, state: int, looks: int) -> TrackTable:
    """Return a table without tracks.

    Args:
        time_s: [] of the table; its dtype is that of the moments.
        tracks: M slots, static.
        state: S, static.
        looks: N of the M-of-N rule, static.

    Example:
        >>> table = empty_table(jnp.asarray(0.0), tracks=2, state=4, looks=3)
        >>> print(table.tracks.identity, table.next_identity)
        [-1 -1] 0
    """
    for name, value in (("tracks", tracks), ("state", state), ("looks", looks)):
        check_size(name, value)
    time_s = jnp.asarray(time_s)
    zeros = lambda *shape: jnp.zeros((tracks, *shape), time_s.dtype)
    nobody = Tracks(
        time_s=time_s,
        mean=zeros(state),
        covariance=zeros(state, state),
        mask=jnp.zeros(tracks, bool),
        identity=jnp.full(tracks, -1, jnp.int32),
        stage=jnp.full(tracks, Stage.EMPTY, jnp.int32),
        existence=zeros(),
        log_score=zeros(),
    )
    return TrackTable(
        nobody,
        jnp.zeros((tracks, looks), bool),
        jnp.zeros(tracks, jnp.int32),
        jnp.zeros(tracks, jnp.int32),
        jnp.zeros((), jnp.int32),
    )


def grade(
    table: TrackTable, hit: Array, counted: Array, valid: Array, params: LifecycleParams
) -> TrackTable:
    """Return the table after a look: tracks confirmed, coasting or deleted.

    Args:
        table: before.
        hit: [M] the look held a detection of the track.
        counted: [M] the look could have held one; where not, it is no miss.
        valid: [] it was a look; where not, nothing changes.
        params: the numbers of hits and misses, and the score.

    Example:
        >>> table = empty_table(jnp.asarray(0.0), tracks=1, state=4, looks=3)
        >>> one = Births(jnp.ones((1, 4)), jnp.eye(4)[None], jnp.ones(1, bool), jnp.zeros(1))
        >>> table = admit(table, one, LifecycleParams()).table
        >>> yes, no = jnp.ones(1, bool), jnp.zeros(1, bool)
        >>> for seen in (yes, yes, no):
        ...     table = grade(table, seen, yes, jnp.array(True), LifecycleParams())
        ...     print(table.tracks.stage)
        [1]
        [2]
        [3]
    """
    check_array("hit", hit, shape=table.misses.shape)
    check_array("counted", counted, shape=table.misses.shape)
    tracks = table.tracks
    check_array("valid", valid, shape=())
    counted = counted & tracks.mask & valid
    hit = hit & counted
    history = jnp.concatenate([table.hit[:, 1:], hit[:, None]], axis=1)
    history = jnp.where(counted[:, None], history, table.hit)
    misses = jnp.where(counted, jnp.where(hit, 0, table.misses + 1), table.misses)
    unseen = jnp.where(tracks.mask & valid, jnp.where(hit, 0, table.unseen + 1), table.unseen)

    enough = history.sum(1, dtype=jnp.int32) >= jnp.asarray(params.confirm_hits)
    enough = enough & (tracks.log_score >= params.confirm_score)
    confirmed = (tracks.stage >= Stage.CONFIRMED) | (hit & enough)
    stage = jnp.where(misses > 0, Stage.COASTING, Stage.CONFIRMED)
    stage = jnp.where(confirmed, stage, Stage.TENTATIVE).astype(tracks.stage.dtype)
    stage = jnp.where(counted, stage, tracks.stage)
    gone = (misses >= params.delete_misses) | (unseen >= params.delete_unseen)
    gone = jnp.where(confirmed, gone, unseen >= params.delete_tentative_misses)
    stays = decided(tracks.mask & ~(gone & valid))
    graded = table._replace(
        tracks=tracks._replace(stage=stage), hit=history, misses=misses, unseen=unseen
    )
    return only(graded, stays)


def admit(table: TrackTable, births: Births, params: LifecycleParams) -> Admission:
    """Return the table with new tracks in its free slots, whether some found none, and whose are.

    The candidates of the highest scores are admitted, into the first free slots; in a full table
    nothing that is there gives way. Every track gets the next identity, which is never used again.
    Being admitted counts as a hit: where one hit is enough, tracks start as confirmed. The score is
    the log odds of their existence.

    Args:
        table: before.
        births: B candidates.
        params: the number of hits, and the score.

    Example:
        >>> table = empty_table(jnp.asarray(0.0), tracks=2, state=4, looks=3)
        >>> two = Births(jnp.ones((3, 4)), jnp.ones((3, 4, 4)), jnp.array([True, False, True]),
        ...              jnp.array([1.0, 9.0, 2.0]))
        >>> table, full, source = admit(table, two, LifecycleParams())
        >>> print(table.tracks.identity, table.tracks.log_score, full, source)
        [0 1] [2. 1.] False [2 0]
    """
    tracks = table.tracks
    candidates, state = births.mean.shape
    check_array("births.mean", births.mean, shape=("B", tracks.mean.shape[1]))
    check_array("births.covariance", births.covariance, shape=(candidates, state, state))
    for name in ("mask", "log_score"):
        check_array(f"births.{name}", getattr(births, name), shape=(candidates,))
    score = jax.lax.stop_gradient(jnp.where(births.mask, births.log_score, 0.0))
    order = jnp.arange(candidates, dtype=jnp.int32)
    # The place of each among the candidates by counting: of so few that is faster than to sort.
    ahead = score[None, :] > score[:, None]
    ahead = ahead | ((score[None, :] == score[:, None]) & (order[None, :] < order[:, None]))
    place = (ahead & births.mask[None, :]).sum(1, dtype=jnp.int32)
    wanted = births.mask.sum(dtype=jnp.int32)

    free = ~tracks.mask
    rank = jnp.cumsum(free, dtype=jnp.int32) - 1  # of a free slot among the free ones
    taken = free & (rank < wanted)
    mine = births.mask[None, :] & (place[None, :] == rank[:, None])
    source = jnp.where(mine, order[None, :], 0).max(1, initial=0)
    whose = decided(jnp.where(taken, source, -1))
    taken, source = whose >= 0, jnp.maximum(whose, 0)
    fill = lambda new, old: jnp.where(taken.reshape(-1, *(1,) * (old.ndim - 1)), new, old)
    at_once = jnp.asarray(params.confirm_hits) <= 1
    at_once = at_once & (births.log_score[source] >= params.confirm_score)
    stage = jnp.where(at_once, Stage.CONFIRMED, Stage.TENTATIVE).astype(tracks.stage.dtype)
    admitted = tracks._replace(
        mean=fill(births.mean[source], tracks.mean),
        covariance=fill(births.covariance[source], tracks.covariance),
        mask=tracks.mask | taken,
        identity=fill(table.next_identity + rank, tracks.identity),
        stage=fill(stage, tracks.stage),
        existence=fill(jax.nn.sigmoid(births.log_score[source]), tracks.existence),
        log_score=fill(births.log_score[source], tracks.log_score),
    )
    first_hit = jnp.zeros_like(table.hit).at[:, -1].set(jnp.ones_like(table.hit[:, -1]))
    number = taken.sum(dtype=jnp.int32)
    after = TrackTable(
        admitted,
        fill(first_hit, table.hit),
        fill(jnp.zeros_like(table.misses), table.misses),
        fill(jnp.zeros_like(table.unseen), table.unseen),
        table.next_identity + number,
    )
    return Admission(after, wanted > number, whose)


def only(table: TrackTable, keep: Array) -> TrackTable:
    """Return the table with the slots of all other tracks empty.

    Args:
        table: M slots.
        keep: [M] which of them stay as they are.

    Example:
        >>> table = empty_table(jnp.asarray(0.0), tracks=1, state=4, looks=3)
        >>> print(only(table, jnp.zeros(1, bool)).tracks.identity)
        [-1]
    """
    clear = lambda x, empty: jnp.where(
        keep.reshape(-1, *(1,) * (x.ndim - 1)), x, jnp.asarray(empty, x.dtype)
    )
    tracks = table.tracks
    empty = {"identity": -1, "stage": Stage.EMPTY}
    fields = {
        name: clear(getattr(tracks, name), empty.get(name, 0))
        for name in tracks._fields
        if name != "time_s"
    }
    return table._replace(
        tracks=tracks._replace(**fields),
        hit=clear(table.hit, False),
        misses=clear(table.misses, 0),
        unseen=clear(table.unseen, 0),
    )
