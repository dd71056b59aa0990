"""A multi-target tracker of Kalman filters: predict, associate, update, grade, admit.

Any associator of `association`, any motion that can be told near a density (`filtering.gaussian`).
Confirmed tracks choose first, tentative ones among what these leave. A detection that no track
claims starts a tentative track at its place, of unknown velocity; M of N looks confirm it, misses
in a row delete it (`tracking.lifecycle`).
"""

from collections.abc import Callable
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from jaxtrack.association import (
    ASSOCIATORS,
    AssociationParams,
    Associator,
    Predicted,
    gate,
    in_turn,
    likelihood_ratios,
    predict_measurement,
)
from jaxtrack.filtering.gaussian import Linear, choose, predicted_covariance
from jaxtrack.models.motion import propagate, transition_matrix
from jaxtrack.models.process import white_noise_acceleration
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
from jaxtrack.tracking.lifecycle import (
    Births,
    LifecycleParams,
    TrackTable,
    admit,
    check_lifecycle,
    empty_table,
    grade,
)
from jaxtrack.tracking.sight import COUNTS, Detect, everywhere
from jaxtrack.types import Array, Estimator, Key, Scan, Stage, Tracks

Move = Callable[[Array, Array, Array], Linear]
"""(mean [S], covariance [S, S], dt_s) → the motion near that density, its noise in `excess`."""

_SEEN = 0.5  # share of a track's weight on detections from which a look counts as a hit


class KalmanTrackerParams(NamedTuple):
    """What the tracker knows of targets and sensor. Traced."""

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

    table: TrackTable
    key: Key  # of the sampled associators


class KalmanTrackerInfo(NamedTuple):
    """What people look at."""

    tracks: Tracks  # at the look's time; after a look that is none, as they were
    weight: Array  # [T, N] how far each detection was each track's
    candidates: Array  # [N] which detections were put up as new tracks
    full: Array  # [] a candidate found no free slot
    converged: Array  # [] the associator's


def kalman_tracker(
    params: KalmanTrackerParams,
    *,
    max_tracks: int,
    associator: str | Associator = "jpda",
    confirm_looks: int = 5,
    move: Move | None = None,
    p_detect: Detect | None = None,
) -> Estimator[Scan, KalmanTrackerState, KalmanTrackerInfo]:
    """Return a tracker of many targets, as an estimator over `Scan`.

    Its state is [x, y, vx, vy]. `existence` is the logistic function of `log_score`, which adds up
    log(1 − P_D P_G + Σ_i w_i) over the looks that count.

    Args:
        params: of targets, sensor, births and lifecycle.
        max_tracks: T, slots of the table, static.
        associator: a name in `ASSOCIATORS`, or an associator with its update.
        confirm_looks: N of the M-of-N rule, static.
        move: motion of a target; None: constant velocity under white-noise acceleration. Traced
            numbers reach it by closure.
        p_detect: share of `params.p_detect` at a place in a look, for sensors that do not see
            everywhere; None: 1. Where it is next to nothing a look is no miss.

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

    Note:
        A detection's delay is not looked at. One that a soft associator shares starts a track only
        if less than half of it is claimed, and none that a confirmed track's gate holds.
    """
    check_size("max_tracks", max_tracks)
    check_size("confirm_looks", confirm_looks)
    if isinstance(associator, str):
        check_choice("associator", associator, tuple(ASSOCIATORS))
        associator = ASSOCIATORS[associator]
    associate, update = associator
    _check(params, confirm_looks)

    def constant_velocity(mean: Array, covariance: Array, dt_s: Array) -> Linear:
        noise = white_noise_acceleration(dt_s, params.sigma_a_m_s2)
        return Linear(propagate(mean, dt_s), transition_matrix(dt_s), noise)

    motion: Move = constant_velocity if move is None else move

    sees = everywhere if p_detect is None else p_detect

    def init(key: Key) -> KalmanTrackerState:
        zero = jnp.zeros((), as_float(params.sigma_m).dtype)
        table = empty_table(zero, tracks=max_tracks, state=4, looks=confirm_looks)
        return KalmanTrackerState(table, key)

    def step(state: KalmanTrackerState, scan: Scan) -> tuple[KalmanTrackerState, KalmanTrackerInfo]:
        table, dtype = state.table, state.table.tracks.mean.dtype
        number = lambda x: jnp.asarray(x, dtype)
        check_mask("scan.valid", scan.valid, shape=())
        check_mask("scan.mask", scan.mask, shape=jnp.shape(scan.position_m)[:1])
        scan = _in(dtype, sound(scan))
        tracks = table.tracks
        time_s = jnp.where(scan.valid, scan.time_s, tracks.time_s)
        dt_s = jnp.where(tracks.mask.any(), time_s - tracks.time_s, 0.0)
        mean, covariance = _predict(tracks, dt_s, motion)
        unit = jnp.eye(2, dtype=dtype)
        noise_m2 = number(params.sigma_m) ** 2 * unit
        predicted = predict_measurement(mean, covariance, noise_m2, tracks.mask)
        detect = number(params.p_detect) * jnp.ones(max_tracks, dtype)
        detect = detect * jax.vmap(sees, (0, None))(mean, scan)
        known = AssociationParams(
            detect, number(params.clutter_per_m2), number(params.gate), number(params.echoes)
        )
        key, draw = jax.random.split(state.key)
        confirmed = tracks.mask & (tracks.stage >= Stage.CONFIRMED)
        found, left = in_turn(associate, predicted, scan, known, draw, confirmed)
        mean, covariance = update(mean, covariance, predicted, scan, found)

        claimed = found.weight.sum(1)
        ratio, miss = likelihood_ratios(predicted, scan, known)
        ratio = jnp.where(confirmed[:, None], ratio, ratio * left[None, :])
        counted = scan.valid & tracks.mask & (detect > COUNTS)
        gain = jnp.where(counted, safe_log(miss + ratio.sum(1)), 0.0)
        score = tracks.log_score + gain
        moved = tracks._replace(
            time_s=time_s,
            mean=mean,
            covariance=covariance,
            log_score=score,
            existence=jnp.where(tracks.mask, jax.nn.sigmoid(score), 0.0),
        )
        graded = grade(table._replace(tracks=moved), claimed >= _SEEN, counted, params.lifecycle)
        free = _unclaimed(predicted, scan, found.weight, tracks, params)
        births = _births(scan, free, noise_m2, params)
        admitted, full = admit(graded, births, params.lifecycle)
        after, key = choose(scan.valid, (admitted, key), (table, state.key))
        info = KalmanTrackerInfo(
            after.tracks, found.weight, free, full & scan.valid, found.converged
        )
        return KalmanTrackerState(after, key), info

    return Estimator(init, step)


def _in(dtype: jnp.dtype, scan: Scan) -> Scan:
    """Return a look whose numbers are of the state's precision."""
    floating = lambda x: jnp.issubdtype(jnp.result_type(x), jnp.floating)
    return jax.tree.map(lambda x: jnp.asarray(x, dtype) if floating(x) else jnp.asarray(x), scan)


def _predict(tracks: Tracks, dt_s: Array, move: Move) -> tuple[Array, Array]:
    """Return predicted means [T, S] and covariances [T, S, S]; empty slots stay as they are."""
    moved = jax.vmap(move, (0, 0, None))(tracks.mean, tracks.covariance, dt_s)
    wider = jax.vmap(predicted_covariance)(tracks.covariance, moved.matrix, moved.excess)
    there = tracks.mask
    mean = jnp.where(there[:, None], moved.value, tracks.mean)
    return mean, jnp.where(there[:, None, None], wider, tracks.covariance)


def _unclaimed(
    predicted: Predicted, scan: Scan, weight: Array, tracks: Tracks, params: KalmanTrackerParams
) -> Array:
    """Return which detections start a track, [N]."""
    counts = scan.mask & scan.valid
    if scan.weight is not None:
        counts = counts & (jnp.where(counts, scan.weight, 0.0) > 0)
    confirmed = predicted.mask & (tracks.stage >= Stage.CONFIRMED)
    held = gate(predicted._replace(mask=confirmed), scan, params.gate).inside.any(0)
    return counts & ~held & (weight.sum(0) < _SEEN)


def _births(scan: Scan, free: Array, noise_m2: Array, params: KalmanTrackerParams) -> Births:
    """Return a candidate for each detection: at its place, at rest, of unknown velocity."""
    dtype = noise_m2.dtype
    places = free.shape[0]
    position = jnp.where(free[:, None], scan.position_m, 0.0).astype(dtype)
    spread = jnp.broadcast_to(noise_m2, (places, 2, 2))
    if params.birth_sigma_m is not None:
        spread = jnp.asarray(params.birth_sigma_m, dtype) ** 2 * jnp.broadcast_to(
            jnp.eye(2, dtype=dtype), (places, 2, 2)
        )
    elif scan.covariance_m2 is not None:
        spread = jnp.where(free[:, None, None], scan.covariance_m2, spread)
    speed = jnp.asarray(params.birth_sigma_m_s, dtype) ** 2
    covariance = jnp.zeros((places, 4, 4), dtype).at[:, :2, :2].set(spread)
    covariance = covariance.at[:, 2:, 2:].set(speed * jnp.eye(2, dtype=dtype)[None])
    weight = jnp.ones(places, dtype) if scan.weight is None else scan.weight
    mean = jnp.concatenate([position, jnp.zeros((places, 2), dtype)], axis=1)
    return Births(mean, covariance, free, safe_log(jnp.where(free, weight, 1.0)))


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
