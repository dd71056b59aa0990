"""How the tracks of a `kalman_tracker` live: what a look does to its table, hard or smooth.

The smooth way puts sigmoids for the thresholds,

    gate:   density σ((γ − d²)/w_g)
    hit:    h_j = σ((Σ_i w_ij − ½)/w_c)
    birth:  σ((½ − Σ_j w_ij)/w_c) Π_j (1 − c_j a_j σ((γ − d²_ij)/w_g))

and `soft_lifecycle` for `lifecycle`.

Where targets give several detections a look, a birth takes its neighbourhood, and no track's gate
holds one, confirmed or not: else every echo of a new target would start a track of its own.
"""

from collections.abc import Callable
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp

from jaxtrack.association import Predicted, gate, gated_once
from jaxtrack.filtering.gaussian import Moments
from jaxtrack.numerics.safe import safe_log
from jaxtrack.tracking.births import one_a_neighbourhood
from jaxtrack.tracking.lifecycle import (
    Births,
    LifecycleParams,
    TrackTable,
    admit,
    empty_table,
    grade,
)
from jaxtrack.tracking.soft_lifecycle import (
    Softness,
    SoftTable,
    check_softness,
    soft_admit,
    soft_empty_table,
    soft_grade,
)
from jaxtrack.types import Array, Scan, Stage, Tracks

_SEEN = 0.5  # share of a track's weight on detections from which a look counts as a hit
_FAR = 20.0  # widths from the gate where nothing is left of a density


class Looked(NamedTuple):
    """What a look says of the tracks of a table, and of what may start."""

    tracks: Tracks  # updated
    predicted: Predicted  # gated
    look: Scan
    weight: Array  # [T, N] how far each detection is each track's
    counted: Array  # [T] the look could have held a detection of the track
    started: Moments  # [N, …] of a new track at each detection
    several: bool = False  # detections near each other may be one target's


class Lived(NamedTuple):
    """What the lives of the tracks are after a look."""

    table: Any
    free: Array  # [N] which detections were put up as new tracks
    full: Array  # [] one of them found no slot
    source: Array  # [T] which detection started the track in a slot; −1: none in this look


class Lives(NamedTuple):
    """How tracks live: what their table is, what the gate leaves, what a look does to them."""

    empty: Callable[..., Any]  # (time_s, tracks=, state=, looks=) → table
    tracks: Callable[[Any], Tracks]  # of a table
    gated: Callable[[Predicted, Scan], Predicted]
    live: Callable[[Any, Looked], Lived]


def hard_lives(limit: Array | float, lifecycle: LifecycleParams) -> Lives:
    """Return lives as `lifecycle` has them: at each look a track is there, and confirmed, or not.

    Args:
        limit: γ of the gate.
        lifecycle: when tracks are confirmed and deleted.

    Example:
        >>> print(hard_lives(9.21, LifecycleParams()).empty(0.0, tracks=2, state=4, looks=3).misses)
        [0 0]
    """

    def gated(predicted: Predicted, look: Scan) -> Predicted:
        return gated_once(predicted, look, jnp.asarray(limit, predicted.position_m.dtype))

    def live(table: TrackTable, looked: Looked) -> Lived:
        tracks, predicted, look, weight, counted, started, several = looked
        hit = weight.sum(1) >= _SEEN
        graded = grade(table._replace(tracks=tracks), hit, counted, look.valid, lifecycle)
        holding = table.tracks.mask & (several | (table.tracks.stage >= Stage.CONFIRMED))
        held = gate(predicted, look).inside & (holding & counted)[:, None]
        free = _candidates(look) & ~held.any(0) & (weight.sum(0) < _SEEN)
        free = _apart(looked, free, limit) if several else free
        births = Births(*started, free, _birth_score(look, free))
        admitted, full, source = admit(graded, births, lifecycle)
        return Lived(admitted, free, full, source)

    return Lives(empty_table, lambda table: table.tracks, gated, live)


def soft_lives(
    softness: Softness | None = None,
) -> Callable[[Array | float, LifecycleParams], Lives]:
    """Return lives for `kalman_tracker(lives=…)` whose tracks have an existence that is smooth.

    `tracks.existence` is the share by which a track is there and confirmed; where it weighs the
    tracks of a loss, the loss has gradients in the gate, all noise, births and `lifecycle`. Which
    slots hold tracks, and whose turn it is to choose, is decided. Tends to the hard lives as the
    widths vanish.

    Args:
        softness: widths; the defaults if None.

    Raises:
        ValueError: a known width is not positive.

    Example:
        >>> from jaxtrack.tracking import KalmanTrackerParams, kalman_tracker
        >>> t = jnp.arange(8.0)
        >>> at = jnp.stack([3 * t, 50 - t], axis=-1)[:, None]
        >>> scans = Scan(t, jnp.ones(8, bool), at, jnp.ones((8, 1), bool))
        >>> params = KalmanTrackerParams(1.0, 0.1, 0.9, 1e-4)
        >>> tracker = kalman_tracker(params, max_tracks=2, lives=soft_lives())
        >>> _, info = jax.lax.scan(tracker.step, tracker.init(jax.random.key(0)), scans)
        >>> print(*(f"{x:.2f}" for x in info.tracks.existence[:, 0]))
        0.00 0.11 0.88 0.99 0.99 0.99 0.99 0.99

    Note:
        The probability 1 − exp(−γ/2) that a detection is inside the gate is that of the hard one.
    """
    softness = Softness() if softness is None else softness
    check_softness(softness)

    def of(limit: Array | float, lifecycle: LifecycleParams) -> Lives:
        def inside(squared_distance: Array) -> Array:
            left = jnp.asarray(limit, squared_distance.dtype) - squared_distance
            return jax.nn.sigmoid(left / jnp.asarray(softness.gate, left.dtype))

        def gated(predicted: Predicted, look: Scan) -> Predicted:
            dtype = predicted.position_m.dtype
            widest = jnp.asarray(limit, dtype) + _FAR * jnp.asarray(softness.gate, dtype)
            found = gate(predicted, look._replace(weight=None), widest)
            near = jnp.where(found.inside, found.squared_distance, 0.0)
            density = jnp.where(found.inside, found.density_per_m2 * inside(near), 0.0)
            return predicted._replace(gated=found._replace(density_per_m2=density))

        def live(soft: SoftTable, looked: Looked) -> Lived:
            tracks, predicted, look, weight, counted, started, several = looked
            width = jnp.asarray(softness.share, weight.dtype)
            held = gate(predicted, look)
            share = jnp.where(held.inside, held.squared_distance, 0.0)
            share = jnp.where(held.inside, inside(share), 0.0)
            holding = soft.alive if several else soft.alive * soft.confirmed
            taken = jnp.where(counted, holding, 0.0)[:, None] * share
            birth = jax.nn.sigmoid((_SEEN - weight.sum(0)) / width) * (1 - taken).prod(0)
            hit = jax.nn.sigmoid((weight.sum(1) - _SEEN) / width)
            before = soft._replace(table=soft.table._replace(tracks=tracks))
            graded = soft_grade(before, hit, counted, look.valid, lifecycle, softness)
            free = _candidates(look) & (birth >= 0.5)
            free = _apart(looked, free, limit) if several else free
            births = Births(*started, free, _birth_score(look, free))
            admitted, admission = soft_admit(graded, births, birth, lifecycle)
            return Lived(admitted, free, admission.full, admission.source)

        return Lives(soft_empty_table, lambda soft: soft.table.tracks, gated, live)

    return of


def _candidates(look: Scan) -> Array:
    """Return which detections may start a track, [N]: those that count."""
    counts = look.mask & look.valid
    return counts if look.weight is None else counts & (jnp.where(counts, look.weight, 0.0) > 0)


def _apart(looked: Looked, free: Array, limit: Array | float) -> Array:
    """Return which of the free detections start a track, one a neighbourhood, [N]."""
    weight = looked.look.weight
    weight = jnp.ones(free.shape, looked.look.position_m.dtype) if weight is None else weight
    return one_a_neighbourhood(looked.started, weight, free, limit)


def _birth_score(look: Scan, free: Array) -> Array:
    """Return the log score that a track starts with at each detection, [N]: its weight's."""
    weight = jnp.ones(free.shape, look.position_m.dtype) if look.weight is None else look.weight
    return safe_log(jnp.where(free, weight, 1.0))
