"""A multi-target tracker of Kalman filters: predict, associate, update, grade, admit.

Any associator of `association`, any filter of `tracking.filters` and its neighbours.
Confirmed tracks choose first, tentative ones among what these leave. A detection that no track
claims starts a tentative track at its place, of unknown velocity; M of N looks confirm it, misses
in a row delete it (`tracking.lifecycle`).
"""

from collections.abc import Callable
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from jaxtrack.association import (
    ASSOCIATORS,
    AssociationParams,
    Associator,
    in_turn,
    likelihood_ratios,
)
from jaxtrack.association.jpda import MAX_TRACKS
from jaxtrack.filtering.gaussian import TreeT, choose
from jaxtrack.numerics.checks import (
    check_array,
    check_choice,
    check_known,
    check_mask,
    check_positive,
    check_probability,
    check_size,
    sound,
)
from jaxtrack.numerics.safe import as_float, safe_log
from jaxtrack.numerics.segments import decided
from jaxtrack.tracking.filters import Filter, straight_filter
from jaxtrack.tracking.lifecycle import LifecycleParams, check_lifecycle
from jaxtrack.tracking.lives import Lives, Looked, hard_lives
from jaxtrack.tracking.sight import COUNTS, Detect, check_sight, everywhere, share_in_sight
from jaxtrack.types import Array, Estimator, Key, Scan, Stage, Tracks

_SURVIVAL = 0.99  # probability that a target is there in the next look too


class KalmanTrackerParams(NamedTuple):
    """What the tracker knows of targets and sensor. Traced."""

    # Of the filter that stands where none is given: these two, and the births' below.
    sigma_m: Array | float  # [] noise of each coordinate, where a scan has no covariances
    sigma_a_m_s2: Array | float  # [] white-noise acceleration of each coordinate
    p_detect: Array | float  # [] inside the sensor's view
    clutter_per_m2: Array | float  # [] expected false detections a square metre and look
    birth_sigma_m_s: Array | float = 10.0  # [] of each coordinate of a new track's velocity
    birth_sigma_m: Array | float | None = None  # [] of its position; None: the detection's noise
    gate: Array | float = 9.21  # [] squared Mahalanobis distance
    echoes: Array | float = 1.0  # [] mean number of echoes, for PMHT
    lifecycle: LifecycleParams = LifecycleParams()


class KalmanTrackerState(NamedTuple):
    """What the next look needs."""

    table: Any  # a TrackTable, or that of other lives
    beliefs: Any  # [T, …] the filter's
    key: Key  # of the sampled associators


class KalmanTrackerInfo(NamedTuple):
    """What people look at."""

    tracks: Tracks  # at the look's time; after a look that is none, as they were
    weight: Array  # [T, N] how far each detection was each track's
    candidates: Array  # [N] which detections were put up as new tracks
    full: Array  # [] a candidate found no free slot
    converged: Array  # [] the associator's
    beliefs: Any  # [T, …] the filter's: of several models their probabilities


def kalman_tracker(
    params: KalmanTrackerParams,
    *,
    max_tracks: int,
    associator: str | Associator = "jpda",
    confirm_looks: int = 5,
    filter: Filter[Any] | None = None,
    p_detect: Detect | None = None,
    lives: Callable[[Array | float, LifecycleParams], Lives] | None = None,
) -> Estimator[Any, KalmanTrackerState, KalmanTrackerInfo]:
    """Return a tracker of many targets, as an estimator over `Scan`, or over the filter's looks.

    Its state is [x, y, vx, vy], or the filter's. `log_score` adds up log L over the looks that
    count, and `existence` is the probability that the track is still a target's,

        L = 1 − P_D P_G + Σ_i w_i,    r ← s r L / (1 − s r + s r L),

    from even odds at birth on (a detection of weight c: c to 1), with s = 0.99 the probability to
    be there in the next look too: after many hits r falls within a few misses, the score does not.

    Args:
        params: of targets, sensor, births and lifecycle.
        max_tracks: T, slots of the table, static.
        associator: a name in `ASSOCIATORS`, or an associator with its update.
        confirm_looks: N of the M-of-N rule, static.
        filter: of the tracks: `position_filter`, `range_bearing_filter`, `interacting_filter`, or
            one's own; None: `straight_filter` with the params' numbers, which no other one reads.
        p_detect: share of `params.p_detect` at a place in a look, for sensors that do not see
            everywhere; None: 1. It counts on the average over where a track may be; where that is
            next to nothing a look is no miss.
        lives: how tracks live, of `params.gate` and `params.lifecycle`; None: `hard_lives`.
            `soft_lives` are differentiable.

    Returns:
        An estimator. A look that is not valid changes nothing; a full table turns candidates away
        and says so; identities are never used again.

    Raises:
        TypeError: a size is not a Python int.
        ValueError: a size is too small, an unknown associator, or a known number that cannot be.

    Example:
        >>> t = jnp.arange(8.0)
        >>> at = jnp.stack([3 * t, 50 - t], axis=-1)[:, None]
        >>> scans = Scan(t, jnp.ones(8, bool), at, jnp.ones((8, 1), bool))
        >>> params = KalmanTrackerParams(1.0, 0.1, 0.9, 1e-4)
        >>> tracker = kalman_tracker(params, max_tracks=2, associator="optimal")
        >>> _, info = jax.lax.scan(tracker.step, tracker.init(jax.random.key(0)), scans)
        >>> print(info.tracks.mean[-1, 0].round(1), info.tracks.stage[:, 0])
        [21. 43.  3. -1.] [1 1 2 2 2 2 2 2]

    Source: of r, D. Mušicki, R. Evans and S. Stankovic, "Integrated probabilistic data
        association", 1994.

    Note:
        A detection's delay is not looked at. One that a soft associator shares starts a track only
        if less than half of it is claimed, and none that a confirmed track's gate holds. Where the
        associator lets a track take several, no track's gate holds one, and of those that may be
        one target's one starts a track (`births.one_a_neighbourhood`).
    """
    check_size("max_tracks", max_tracks)
    check_size("confirm_looks", confirm_looks)
    if isinstance(associator, str):
        check_choice("associator", associator, tuple(ASSOCIATORS))
        if associator == "jpda" and max_tracks > MAX_TRACKS:
            raise ValueError(
                f"max_tracks: got {max_tracks}, want at most {MAX_TRACKS} with jpda; "
                "belief_propagation takes more"
            )
        associator = ASSOCIATORS[associator]
    associate, update, several = associator
    _check(params, confirm_looks)

    numbers = params.sigma_m, params.sigma_a_m_s2, params.birth_sigma_m_s, params.birth_sigma_m
    of: Filter[Any] = straight_filter(*numbers) if filter is None else filter
    sees = check_sight(p_detect)
    try:
        way = (hard_lives if lives is None else lives)(params.gate, params.lifecycle)
    except TypeError as error:
        want = "None or a function of a gate and LifecycleParams, as soft_lives() returns"
        raise TypeError(f"lives: got {lives!r}, want {want}") from error

    dtype = as_float(params.sigma_m).dtype

    def init(key: Key) -> KalmanTrackerState:
        zero, none = jnp.zeros((), dtype), jnp.zeros(max_tracks, bool)
        nowhere = Scan(zero, jnp.asarray(False), jnp.zeros((max_tracks, 2), dtype), none)
        beliefs = of.start(nowhere)
        size = of.moments(beliefs).mean.shape[1]
        table = way.empty(zero, tracks=max_tracks, state=size, looks=confirm_looks)
        return KalmanTrackerState(table, jax.tree.map(jnp.zeros_like, beliefs), key)

    def step(state: KalmanTrackerState, scan: Any) -> tuple[KalmanTrackerState, KalmanTrackerInfo]:
        tracks = way.tracks(state.table)
        number = lambda x: jnp.asarray(x, dtype)
        check_mask("scan.valid", scan.valid, shape=())
        check_mask("scan.mask", scan.mask, shape=("N",))
        scan = _in(dtype, scan)
        look = of.look(scan)
        check_mask("scan.mask", look.mask, shape=jnp.shape(look.position_m)[:1])
        look = sound(look)
        time_s = jnp.where(look.valid, look.time_s, tracks.time_s)
        dt_s = jnp.where(tracks.mask.any(), time_s - tracks.time_s, 0.0)
        moved = _where(tracks.mask, of.predict(state.beliefs, dt_s), state.beliefs)
        predicted = way.gated(of.measure(moved, scan, tracks.mask), look)
        detect = number(params.p_detect) * jnp.ones(max_tracks, dtype)
        if sees is not everywhere:
            detect = detect * share_in_sight(sees, of.moments(moved), scan)
        known = AssociationParams(
            detect, number(params.clutter_per_m2), number(params.gate), number(params.echoes)
        )
        key, draw = jax.random.split(state.key)
        confirmed = decided(tracks.mask & (tracks.stage >= Stage.CONFIRMED))
        found, left = in_turn(associate, predicted, look, known, draw, confirmed)
        learnt = of.update(moved, predicted, look, found, update)
        mean, covariance = of.moments(learnt)

        ratio, miss = likelihood_ratios(predicted, look, known)
        ratio = jnp.where(confirmed[:, None], ratio, ratio * left[None, :])
        counted = look.valid & tracks.mask & (detect > COUNTS)
        gain = jnp.where(counted, safe_log(miss + ratio.sum(1)), 0.0)
        score = tracks.log_score + gain
        updated = tracks._replace(
            time_s=time_s,
            mean=mean,
            covariance=covariance,
            log_score=score,
            existence=jnp.where(counted, _exists(tracks.existence, gain), tracks.existence),
        )
        started = of.start(look)
        looked = Looked(
            updated, predicted, look, found.weight, counted, of.moments(started), several
        )
        lived = way.live(state.table, looked)
        table = way.tracks(lived.table)
        kept = _where(table.mask, learnt, jax.tree.map(jnp.zeros_like, learnt))
        beliefs = _where(lived.source >= 0, jax.tree.map(lambda x: x[lived.source], started), kept)
        after, beliefs, key = choose(
            look.valid, (lived.table, beliefs, key), (state.table, state.beliefs, state.key)
        )
        # The table's own are these, and would lead back to them by a second way.
        mean, covariance = of.moments(beliefs)
        info = KalmanTrackerInfo(
            way.tracks(after)._replace(mean=mean, covariance=covariance),
            found.weight,
            lived.free,
            lived.full & look.valid,
            found.converged,
            beliefs,
        )
        return KalmanTrackerState(after, beliefs, key), info

    return Estimator(init, step)


def _exists(before: Array, gain: Array) -> Array:
    """Return the probability of existence after a look of log-likelihood ratio `gain`."""
    still = _SURVIVAL * before
    return jax.nn.sigmoid(safe_log(still) - jnp.log1p(-still) + gain)


def _in(dtype: jnp.dtype, scan: TreeT) -> TreeT:
    """Return a look whose numbers are of the state's precision."""
    floating = lambda x: jnp.issubdtype(jnp.result_type(x), jnp.floating)
    return jax.tree.map(lambda x: jnp.asarray(x, dtype) if floating(x) else jnp.asarray(x), scan)


def _where(slots: Array, yes: TreeT, no: TreeT) -> TreeT:
    """Return one of two tables for each slot [T]."""
    pick = lambda a, b: jnp.where(slots.reshape(-1, *(1,) * (a.ndim - 1)), a, b)
    return jax.tree.map(pick, yes, no)


def _check(params: KalmanTrackerParams, confirm_looks: int) -> None:
    dtype = jnp.result_type(float)
    for name, value in params._asdict().items():
        if name != "lifecycle" and value is not None:
            check_array(f"params.{name}", value, shape=())
    for name in ("sigma_m", "clutter_per_m2", "birth_sigma_m_s", "echoes"):
        check_positive(f"params.{name}", getattr(params, name), dtype)
    if params.birth_sigma_m is not None:
        check_positive("params.birth_sigma_m", params.birth_sigma_m, dtype)
    amount = lambda x: (x >= 0) & np.isfinite(x)
    want = "an acceleration of at least 0 m/s²"
    check_known("params.sigma_a_m_s2", params.sigma_a_m_s2, amount, want)
    check_known("params.gate", params.gate, lambda x: x > 0, "a positive number")
    check_probability("params.p_detect", params.p_detect, dtype)
    check_lifecycle(params.lifecycle, confirm_looks)
