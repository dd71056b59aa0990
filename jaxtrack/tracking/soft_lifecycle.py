"""The life of tracks in shares: the smooth twin of `lifecycle`, with an existence for each track.

Hits are shares, runs of misses are expected numbers, and thresholds are sigmoids of stated widths.
A track is there by the share that no deletion has taken, and confirmed by the share of which some
look has confirmed it; their product is its existence. Which slot a track takes, and when it is
free again, is decided at one half and has no gradient.
"""

from typing import NamedTuple

import jax
import jax.numpy as jnp

from jaxtrack.numerics.checks import check_array, check_positive
from jaxtrack.tracking.lifecycle import (
    Admission,
    Births,
    LifecycleParams,
    TrackTable,
    admit,
    empty_table,
    only,
)
from jaxtrack.types import Array, Stage

_ENDLESS = 1e30  # stands for a score of ±∞, of which the width has no gradient


class Softness(NamedTuple):
    """Widths of the sigmoids that stand for thresholds. Traced; as they vanish all is hard."""

    share: Array | float = 0.1  # of a detection that is claimed
    looks: Array | float = 0.25  # of numbers of hits and misses
    score: Array | float = 1.0  # of the log score, nats
    gate: Array | float = 1.0  # of the squared Mahalanobis distance


class SoftTable(NamedTuple):
    """Tracks and what their existence depends on."""

    table: TrackTable  # hits are shares; misses and unseen looks expected numbers
    alive: Array  # [M] share that no deletion has taken
    confirmed: Array  # [M] share that some look has confirmed


def check_softness(softness: Softness) -> None:
    """Check known widths.

    Raises:
        ValueError: one is not a scalar, or not positive.

    Example:
        >>> check_softness(Softness())
    """
    for name, value in softness._asdict().items():
        check_array(f"softness.{name}", value, shape=())
        check_positive(f"softness.{name}", value, jnp.result_type(float))


def soft_empty_table(time_s: Array, *, tracks: int, state: int, looks: int) -> SoftTable:
    """Return a table without tracks, as `empty_table` does.

    Example:
        >>> print(soft_empty_table(jnp.asarray(0.0), tracks=2, state=4, looks=3).alive)
        [0. 0.]
    """
    table = empty_table(time_s, tracks=tracks, state=state, looks=looks)
    dtype = table.tracks.mean.dtype
    floating = {name: getattr(table, name).astype(dtype) for name in ("hit", "misses", "unseen")}
    nothing = jnp.zeros(tracks, dtype)
    return SoftTable(table._replace(**floating), nothing, nothing)


def soft_grade(
    soft: SoftTable,
    hit: Array,
    counted: Array,
    valid: Array,
    params: LifecycleParams,
    softness: Softness,
) -> SoftTable:
    """Return the table after a look: shares confirmed and deleted.

        m ← (1 − h)(m + 1),    u ← (1 − h)(u + 1),    n = Σ of the last N h
        c ← c + (1 − c) h σ((n − M + ½)/w_l) σ((s − s_0)/w_s)
        a ← a [c (1 − σ((m − D + ½)/w_l)) (1 − σ((u − U + ½)/w_l)) + (1 − c)(1 − σ((u − D_t + ½)/w_l))]

    with h the share of a hit, and as in `grade` m only of looks that counted. Were hits independent
    of each other, m and u were the expected numbers of misses in a row. Tends to `grade` as the
    widths vanish.

    Args:
        soft: before.
        hit: [M] h: how far the look held a detection of the track.
        counted: [M] the look could have held one; where not, it is no miss.
        valid: [] it was a look; where not, nothing changes.
        params: M, s_0, D, D_t and U.
        softness: w_l and w_s.

    Example:
        >>> soft = soft_empty_table(jnp.asarray(0.0), tracks=1, state=4, looks=3)
        >>> one = Births(jnp.ones((1, 4)), jnp.eye(4)[None], jnp.ones(1, bool), jnp.zeros(1))
        >>> soft, *_ = soft_admit(soft, one, jnp.ones(1), LifecycleParams(2))
        >>> for h in (0.9, 0.9, 0.0):
        ...     soft = soft_grade(soft, jnp.full(1, h), jnp.ones(1, bool), jnp.array(True),
        ...                       LifecycleParams(2), Softness())
        ...     print(f"{soft.table.tracks.existence[0]:.2f}")
        0.75
        0.97
        0.97
    """  # noqa: E501
    table, tracks = soft.table, soft.table.tracks
    for name, value in (("hit", hit), ("counted", counted)):
        check_array(name, value, shape=table.misses.shape)
    check_array("valid", valid, shape=())
    dtype = table.misses.dtype
    number = lambda x: jnp.asarray(x, dtype)
    above = lambda x, least: jax.nn.sigmoid((x - number(least) + 0.5) / number(softness.looks))
    there = tracks.mask & valid
    counted = counted & there
    hit = jnp.where(counted, hit, 0.0)
    history = jnp.concatenate([table.hit[:, 1:], hit[:, None]], axis=1)
    history = jnp.where(counted[:, None], history, table.hit)
    misses = jnp.where(counted, (1 - hit) * (table.misses + 1), table.misses)
    unseen = jnp.where(there, (1 - hit) * (table.unseen + 1), table.unseen)

    level = number(params.confirm_score)
    level = jnp.where(level > _ENDLESS, _ENDLESS, jnp.where(level < -_ENDLESS, -_ENDLESS, level))
    enough = jax.nn.sigmoid((tracks.log_score - level) / number(softness.score))
    enough = enough * above(history.sum(1), params.confirm_hits)
    confirmed = soft.confirmed + (1 - soft.confirmed) * hit * enough
    stays = (1 - above(misses, params.delete_misses)) * (1 - above(unseen, params.delete_unseen))
    stays = confirmed * stays + (1 - confirmed) * (
        1 - above(unseen, params.delete_tentative_misses)
    )
    alive = jnp.where(there, soft.alive * stays, soft.alive)

    stage = jnp.where(misses >= 0.5, Stage.COASTING, Stage.CONFIRMED)
    stage = jnp.where(confirmed >= 0.5, stage, Stage.TENTATIVE).astype(tracks.stage.dtype)
    tracks = tracks._replace(stage=jnp.where(counted, stage, tracks.stage))
    graded = table._replace(tracks=tracks, hit=history, misses=misses, unseen=unseen)
    keep = tracks.mask & ((alive >= 0.5) | ~valid)
    clear = lambda x: jnp.where(keep, x, 0.0)
    return _with_existence(only(graded, keep), clear(alive), clear(confirmed))


def soft_admit(
    soft: SoftTable, births: Births, share: Array, params: LifecycleParams
) -> tuple[SoftTable, Admission]:
    """Return the table with new tracks in its free slots, and what `admit` says of them.

    Args:
        soft: before.
        births: B candidates, decided.
        share: [B] by which each is there.
        params: the number of hits, and the score.

    Example:
        >>> soft = soft_empty_table(jnp.asarray(0.0), tracks=2, state=4, looks=3)
        >>> one = Births(jnp.ones((1, 4)), jnp.eye(4)[None], jnp.ones(1, bool), jnp.zeros(1))
        >>> soft, admission = soft_admit(soft, one, jnp.full(1, 0.8), LifecycleParams())
        >>> print(soft.alive, soft.confirmed, admission.source)
        [0.8 0. ] [0. 0.] [ 0 -1]
    """
    admission = admit(soft.table, births, params)
    new, table = admission.source >= 0, admission.table
    at_once = (table.tracks.stage >= Stage.CONFIRMED).astype(share.dtype)
    alive = jnp.where(new, share[admission.source], soft.alive)
    return _with_existence(table, alive, jnp.where(new, at_once, soft.confirmed)), admission


def _with_existence(table: TrackTable, alive: Array, confirmed: Array) -> SoftTable:
    tracks = table.tracks._replace(existence=alive * confirmed)
    return SoftTable(table._replace(tracks=tracks), alive, confirmed)
