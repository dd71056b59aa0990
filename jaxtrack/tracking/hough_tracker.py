"""A multi-target tracker on window estimates: estimate, associate, smooth, grade, admit.

Every look a window estimator, any one, finds targets' positions and velocities in the last W valid
looks. Tracks are told which estimate is theirs by position and velocity, take it in, and are graded
by it; an estimate in no track's gate becomes a tentative track. It does not wait for W looks: the
first windows hold what there is.
"""

from collections.abc import Callable
from typing import Any, Generic, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from jaxtrack.filtering.gaussian import Moments, choose, correct, predict
from jaxtrack.models.motion import transition_matrix
from jaxtrack.models.process import white_noise_acceleration
from jaxtrack.numerics.assignment import pair_up
from jaxtrack.numerics.checks import check_array, check_known, check_size, sound
from jaxtrack.numerics.definite import rounding_floor, scaled_root
from jaxtrack.tracking.lifecycle import (
    Births,
    LifecycleParams,
    TrackTable,
    admit,
    check_lifecycle,
    empty_table,
    grade,
)
from jaxtrack.tracking.sight import COUNTS, Detect, check_sight
from jaxtrack.tracking.sliding import sliding
from jaxtrack.types import Array, Estimator, InfoT, Key, ScanT, Tracks


class HoughTrackerParams(NamedTuple):
    """What the tracker knows of targets. Traced."""

    sigma_a_m_s2: Array | float = 0.01  # [] white-noise acceleration of each coordinate
    # Squared distance in [x, y, vx, vy]. Wide, as the vote over few looks may leap from one maximum
    # to another, and what lies out of the gate starts a second track of the same target.
    gate: Array | float = 160.0
    lifecycle: LifecycleParams = LifecycleParams(confirm_hits=1, delete_misses=8)


class Past(NamedTuple):
    """Where the tracks were after each of the last W valid looks, the oldest first."""

    time_s: Array  # [W]
    mean: Array  # [W, T, 4]
    covariance: Array  # [W, T, 4, 4]
    known: Array  # [W, T] the track that is in the slot now was there


class HoughTrackerState(NamedTuple, Generic[ScanT]):
    """What the next look needs."""

    looks: ScanT  # the last W valid ones, stacked
    table: TrackTable
    past: Past


class HoughTrackerInfo(NamedTuple, Generic[InfoT]):
    """What people look at."""

    tracks: Tracks  # at the look's time; after a look that is none, as they were
    estimates: Tracks  # of the window
    owner: Array  # [M] slot of the track that each estimate is of; −1: none's, or there is none
    full: Array  # [] an estimate found no free slot
    info: InfoT  # the window estimator's


def hough_tracker(
    estimate: Callable[[ScanT], tuple[Tracks, InfoT]],
    params: HoughTrackerParams = HoughTrackerParams(),  # noqa: B008 - an immutable tuple
    *,
    like: ScanT,
    window: int,
    max_tracks: int,
    confirm_looks: int = 5,
    p_detect: Detect | None = None,
) -> Estimator[ScanT, HoughTrackerState, HoughTrackerInfo]:
    """Return a tracker that associates and smooths what a window estimator finds.

    A pair of a predicted track and an estimate costs (x̂ − x)ᵀ (P + P̂)⁻¹ (x̂ − x) − 2 log q, with q
    the share of hits in the track's last N looks and one more, so that of two tracks the better
    one has the estimate. Pairs are assigned at the least total cost, a miss costs the gate, and an
    estimate in the gate of any track starts none. Successive windows share W − 1 looks, so an
    estimate is not new to its track. It is to what the track was W looks ago,
    carried to now, whose looks are all others: that is what it is fused with,

        x = x₋ + P₋ (P₋ + P̂)⁻¹ (x̂ − x₋),    P = P₋ − P₋ (P₋ + P̂)⁻¹ P₋,

    and no look counts twice. Younger tracks are their estimates. For the same reason hits in a row
    say little: `lifecycle.confirm_score` is what confirms a track.

    Args:
        estimate: the window estimator, its parameters bound: `scans [W, ...] -> (tracks, info)`,
            with states [x, y, vx, vy] at the window's last look, covariances and scores.
        params: of targets, gate and lifecycle.
        like: one look of the kind that will come: its shapes and dtypes count, its values do not.
        window: W, looks, static.
        max_tracks: T, slots of the table, static.
        confirm_looks: N of the M-of-N rule, static.
        p_detect: probability of a detection at a place in a look; None: 1. Where it is next to
            nothing a look is no miss.

    Returns:
        An estimator. A look that is not valid changes nothing; a full table turns estimates away
        and says so; identities are never used again. `existence` is the share of hits in
        the last N looks, `log_score` that of the last estimate.

    Raises:
        TypeError: a size is not a Python int.
        ValueError: a size is too small, or a known number that cannot be.

    Example:
        >>> from jaxtrack.hough import SpeedGate, joint
        >>> from jaxtrack.models import PositionSensor
        >>> from jaxtrack.types import Scan
        >>> t = jnp.arange(8.0)
        >>> at = jnp.stack([30 * t, 500 - 20 * t], axis=-1)[:, None]
        >>> scans = Scan(t, jnp.ones(8, bool), at, jnp.ones((8, 1), bool))
        >>> voted = joint.JointParams(PositionSensor(0.9, 1e-7, 5.0), SpeedGate(0.0, 60.0), 8.0)
        >>> sizes = joint.JointSizes(tracks=1, hypotheses=16, gap=2)
        >>> tracker = hough_tracker(
        ...     lambda looks: joint.estimate(looks, voted, sizes=sizes),
        ...     like=jax.tree.map(lambda x: x[0], scans), window=5, max_tracks=2)
        >>> run = jax.jit(lambda: jax.lax.scan(tracker.step, tracker.init(jax.random.key(0)), scans))
        >>> tracks = run()[1].tracks
        >>> print(tracks.mean[-1, 0].round(), tracks.stage[:, 0])
        [210. 360.  30. -20.] [0 0 2 2 2 2 2 2]

    Source: clustering-statistic Hough transform (2018), section IV, which gives the steps in words
    only.
    """  # noqa: E501
    check_size("max_tracks", max_tracks)
    check_size("confirm_looks", confirm_looks)
    _check(params, confirm_looks)
    window_of, look_at = sliding(estimate, like=like, window=window)
    sees = check_sight(p_detect)

    def init(key: Key) -> HoughTrackerState:
        looks: Any = window_of(key)
        zero = jnp.zeros((), looks.time_s.dtype)
        table = empty_table(zero, tracks=max_tracks, state=4, looks=confirm_looks)
        copies = lambda x: jnp.zeros((window, *x.shape), x.dtype)
        tracks = table.tracks
        past = Past(*map(copies, (zero, tracks.mean, tracks.covariance, tracks.mask)))
        return HoughTrackerState(looks, table, past)

    def step(state: HoughTrackerState, scan: ScanT) -> tuple[HoughTrackerState, HoughTrackerInfo]:
        look: Any = sound(scan)
        looks, (estimates, info, _) = look_at(state.looks, look)
        table, past = state.table, state.past
        valid = look.valid
        now = jnp.where(valid, estimates.time_s, table.tracks.time_s).astype(past.time_s.dtype)
        estimates = _cleaned(estimates, estimates.mask & valid)
        there = table.tracks.mask
        since = jnp.where(there.any(), now - table.tracks.time_s, 0.0)
        moved = _carry(table.tracks.mean, table.tracks.covariance, there, since, params)
        quality = (1 + table.hit.sum(1, dtype=now.dtype)) / (1 + confirm_looks)
        columns, claimed = _associate(moved, there, estimates, quality, params)
        hit = columns >= 0

        own = Moments(estimates.mean[columns], estimates.covariance[columns])
        old = past.known[0]
        since = jnp.where(old.any(), now - past.time_s[0], 0.0)
        ago = _carry(past.mean[0], past.covariance[0], old, since, params)
        fused = jax.vmap(_fuse)(ago, own)
        mean, covariance = _where(hit, _where(old, fused, own), moved)
        counted = valid & there & (jax.vmap(sees, (0, None))(moved.mean, look) > COUNTS)
        updated = table.tracks._replace(
            time_s=now,
            mean=mean,
            covariance=covariance,
            log_score=jnp.where(hit, estimates.log_score[columns], table.tracks.log_score),
        )
        graded = grade(table._replace(tracks=updated), hit, counted | hit, valid, params.lifecycle)
        births = Births(
            estimates.mean, estimates.covariance, estimates.mask & ~claimed, estimates.log_score
        )
        after, full, _ = admit(graded, births, params.lifecycle)
        share = jnp.where(after.tracks.mask, after.hit.mean(1, dtype=now.dtype), 0.0)
        after = after._replace(tracks=after.tracks._replace(existence=share))

        same = after.tracks.mask & (after.tracks.identity == table.tracks.identity)
        last = Past(now, after.tracks.mean, after.tracks.covariance, after.tracks.mask)
        older = past._replace(known=past.known & same[None])
        pushed = jax.tree.map(lambda old, new: jnp.concatenate([old[1:], new[None]]), older, last)
        after, past = choose(valid, (after, pushed), (table, past))
        slots = jnp.arange(max_tracks, dtype=jnp.int32)
        mine = columns[None, :] == jnp.arange(estimates.mask.shape[0], dtype=jnp.int32)[:, None]
        owner = jnp.where(mine, slots[None], -1).max(1)
        shown = HoughTrackerInfo(after.tracks, estimates, owner, full & valid, info)
        return HoughTrackerState(looks, after, past), shown

    return Estimator(init, step)


def _cleaned(estimates: Tracks, mask: Array) -> Tracks:
    """Return estimates whose masked ones hold what does no harm, to gradients neither."""
    unit = jnp.eye(4, dtype=estimates.mean.dtype)[None]
    return estimates._replace(
        mean=jnp.where(mask[:, None], estimates.mean, 0.0),
        covariance=jnp.where(mask[:, None, None], estimates.covariance, unit),
        log_score=jnp.where(mask, estimates.log_score, 0.0),
        mask=mask,
    )


def _carry(
    mean: Array, covariance: Array, there: Array, dt_s: Array, params: HoughTrackerParams
) -> Moments:
    """Return tracks some time later; what is not there holds what does no harm."""
    noise = white_noise_acceleration(dt_s, params.sigma_a_m_s2)
    move = transition_matrix(dt_s)
    later = jax.vmap(lambda m, p: predict(m, p, move, noise))(mean, covariance)
    unit = jnp.eye(4, dtype=mean.dtype)[None]
    return _where(
        there, later, Moments(jnp.zeros_like(mean), jnp.broadcast_to(unit, later[1].shape))
    )


def _associate(
    tracks: Moments, there: Array, estimates: Tracks, quality: Array, params: HoughTrackerParams
) -> tuple[Array, Array]:
    """Return which estimate each track gets, −1 for none, and which estimates lie in some gate."""
    pair = there[:, None] & estimates.mask[None, :]

    def distance(mean: Array, covariance: Array, estimate: Array, spread: Array) -> Array:
        total = covariance + spread
        root = scaled_root(total, floor=rounding_floor(total))[0]
        return ((root @ (estimate - mean)) ** 2).sum()

    each = jax.vmap(jax.vmap(distance, (None, None, 0, 0)), (0, 0, None, None))
    square = each(*tracks, estimates.mean, estimates.covariance)
    gate = jnp.asarray(params.gate, square.dtype)
    inside = pair & (square < gate)
    # A pair gains what a miss would cost more.
    gain = gate - square + 2 * jnp.log(quality)[:, None]
    return pair_up(jnp.where(inside, gain, 0.0)), inside.any(0)


def _fuse(before: Moments, own: Moments) -> Moments:
    """Return two independent densities of one state taken together."""
    unit = jnp.eye(4, dtype=before.mean.dtype)
    after = correct(*before, own.mean - before.mean, unit, own.covariance)
    return Moments(after.mean, after.covariance)


def _where(condition: Array, yes: Moments, no: Moments) -> Moments:
    """Return one of two densities for each track."""
    mean = jnp.where(condition[:, None], yes.mean, no.mean)
    return Moments(mean, jnp.where(condition[:, None, None], yes.covariance, no.covariance))


def _check(params: HoughTrackerParams, confirm_looks: int) -> None:
    for name in ("sigma_a_m_s2", "gate"):
        check_array(f"params.{name}", getattr(params, name), shape=())
    amount = lambda x: (x >= 0) & np.isfinite(x)
    want = "an acceleration of at least 0 m/s²"
    check_known("params.sigma_a_m_s2", params.sigma_a_m_s2, amount, want)
    check_known("params.gate", params.gate, lambda x: x > 0, "a positive number")
    check_lifecycle(params.lifecycle, confirm_looks)
