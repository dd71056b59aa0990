"""One trial of the study `csht_tracking`: targets come and go, all trackers see the same looks.

Scene and rates are traced: every cell of every table is the same compiled program. The false-alarm
model is static, and so are the trackers' settings, fixed for all cells. Files of studies name the
parts: the scene `table_7`, the method `follow`, and the metrics.
"""

import functools
from collections.abc import Callable
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp

from jaxtrack.metrics import ospa
from jaxtrack.models import BeamSonar
from jaxtrack.sensors import (
    SonarScene,
    SonarSceneLimits,
    in_sight,
    observe_known_beams,
    random_sonar_scene,
    tracking_scene,
)
from jaxtrack.studies.csht.cells import Rates
from jaxtrack.studies.csht.trial import BEAM_COUNT, CUTOFF, ORDER
from jaxtrack.studies.tracking.consistency import Consistency, Found, consistency_of
from jaxtrack.studies.tracking.trackers import FLOOR, TRACKERS, Crowded, floor, track
from jaxtrack.types import Array, BeamScan, Key, Truth

TRUTHS = ("visible", "table")
_SETTLED_S = 10.0


class Inputs(NamedTuple):
    """What one program is run with. Traced."""

    scene: SonarScene  # its truth: that of the table
    visible: Truth  # while the sonar can see the targets


class Seen(NamedTuple):
    """What one trial simulates."""

    inputs: Inputs
    scans: BeamScan
    origin: Array  # [T, B] the target of a detection, −1 of clutter
    false_alarms: str  # known to Python, like the next
    targets: int  # that the joint vote looks for in a window


class Scores(NamedTuple):
    """How far one tracker is from one truth, look by look, metres."""

    distance: Array  # [T] OSPA
    localization: Array  # [T]
    cardinality: Array  # [T]


class Outcome(NamedTuple):
    """What one trial gives."""

    scores: dict[str, dict[str, Scores]]  # by truth and tracker
    consistency: dict[str, Consistency]  # by tracker
    overflow: Array  # [T] tables of the joint vote were too small
    full: dict[str, Array]  # [T] by tracker: its table turned somebody away
    quiet: Array  # [T] no birth or death in the last ten seconds


@functools.cache
def trial(false_alarms: str, *, targets: int = 6) -> Callable[[Key, Inputs], Outcome]:
    """Return the function of one trial, the same object for the same model of false alarms.

    Args:
        false_alarms: `"per_beam"` or `"per_scan"`.
        targets: that the joint vote looks for in a window.
    """

    def run(key: Key, inputs: Inputs) -> Outcome:
        seen = look(key, inputs, false_alarms, targets)
        found, full, overflow = {}, {}, jnp.zeros(seen.scans.time_s.shape, bool)
        for name in TRACKERS:
            found[name], crowded = _track(seen, name)
            overflow, full[name] = overflow | crowded.overflow, crowded.full
        found[FLOOR] = follow(seen, tracker=FLOOR)
        scores = {
            which: {name: scores_of(tracks, truth) for name, tracks in found.items()}
            for which, truth in _truths(inputs).items()
        }
        agreed = {name: consistency_of(tracks, inputs.visible) for name, tracks in found.items()}
        full[FLOOR] = jnp.zeros_like(overflow)
        return Outcome(scores, agreed, overflow, full, quiet_looks(inputs.visible))

    return run


def look(key: Key, inputs: Inputs, false_alarms: str, targets: int = 6) -> Seen:
    """Return the looks of one trial."""
    scans, origin = observe_known_beams(
        key, *inputs.scene, beams=BEAM_COUNT, false_alarms=false_alarms
    )
    return Seen(inputs, scans, origin, false_alarms, targets)


def table_7(
    key: Key, *, p_miss: Any, p_false: Any, sigma_m: Any, false_alarms: str = "per_beam"
) -> Seen:
    """Return looks at the paper's five targets that come and go.

    Args:
        key: random key.
        p_miss: of a look at a target.
        p_false: of a beam, or of a look.
        sigma_m: of a range.
        false_alarms: per_beam or per_scan, static.

    Example:
        >>> looks = lambda key: table_7(key, p_miss=0.3, p_false=0.3, sigma_m=3.0).scans
        >>> jax.eval_shape(looks, jax.random.key(0)).range_m.shape
        (199, 90)
    """
    return look(key, inputs_of(Rates(p_miss, p_false, sigma_m)), false_alarms)


def inputs_of(cell: Rates) -> Inputs:
    """Return what trials of a cell are run with."""
    scene, visible = tracking_scene("table"), tracking_scene("visible").truth
    rates = {name: jnp.asarray(x) for name, x in cell._asdict().items()}
    scene = scene._replace(sonar=scene.sonar._replace(**rates))
    return jax.tree.map(jnp.asarray, Inputs(scene, visible))


def follow(seen: Seen, *, tracker: str) -> Found:
    """Return what one of `TRACKERS`, or `FLOOR`, reports; static."""
    if tracker != FLOOR:
        return _track(seen, tracker)[0]
    scene, visible = seen.inputs
    return floor(seen.scans, seen.origin, visible, scene.sonar, seen.false_alarms)


def _track(seen: Seen, name: str) -> tuple[Found, Crowded]:
    return track(name, seen.scans, seen.inputs.scene.sonar, seen.false_alarms, seen.targets)


def ospa_m(seen: Seen, found: Found, *, truth: str) -> Array:
    """Return the mean OSPA distance over looks; `truth` is one of `TRUTHS`."""
    return _scores(seen, found, truth).distance.mean()


def localization_m(seen: Seen, found: Found, *, truth: str) -> Array:
    """Return the mean localization error over looks."""
    return _scores(seen, found, truth).localization.mean()


def cardinality_m(seen: Seen, found: Found, *, truth: str) -> Array:
    """Return the mean cardinality error over looks."""
    return _scores(seen, found, truth).cardinality.mean()


def _scores(seen: Seen, found: Found, truth: str) -> Scores:
    return scores_of(found, _truths(seen.inputs)[truth])


def _truths(inputs: Inputs) -> dict[str, Truth]:
    return dict(zip(TRUTHS, (inputs.visible, inputs.scene.truth), strict=True))


def generated_trial(key: Key, inputs: BeamSonar) -> Outcome:
    """Return one trial on a scene of its own: one to eight targets that come, cross and go."""
    draw, number, spans, look = jax.random.split(key, 4)
    targets, looks = 8, 120
    scene, _ = random_sonar_scene(
        draw,
        inputs,
        SonarSceneLimits(seen_share=0.3),
        targets=targets,
        count=jax.random.randint(number, (), 1, targets + 1),
        looks=looks,
        beams=BEAM_COUNT,
    )
    share = jax.random.uniform(spans, (2, targets), scene.truth.state.dtype)
    born, gone = looks * share[0] / 2, looks * (0.5 + share[1])
    step = jnp.arange(looks)[:, None]
    there = scene.truth.mask & (step >= born[None]) & (step < gone[None])
    truth = in_sight(scene.truth._replace(mask=there), scene.pose, inputs)
    return trial("per_beam", targets=9)(look, Inputs(scene._replace(truth=truth), truth))


def quiet_looks(truth: Truth) -> Array:
    """Return which looks have no birth or death in the last ten seconds, [T].

    Args:
        truth: T looks; what is there at the first is born then.
    """
    before = jnp.concatenate([jnp.zeros_like(truth.mask[:1]), truth.mask[:-1]])
    changed = (truth.mask != before).any(1)
    ago_s = truth.time_s[:, None] - truth.time_s[None, :]
    recent = (ago_s >= 0) & (ago_s < _SETTLED_S)
    return ~(recent & changed[None, :]).any(1)


def scores_of(found: Found, truth: Truth) -> Scores:
    """Return how far what is reported is from what is true, look by look."""
    each = jax.vmap(
        lambda mean, mask, state, there: ospa(
            mean[:, :2], mask, state[:, :2], there, cutoff=CUTOFF, order=ORDER
        )
    )
    return Scores(*each(found.mean, found.mask, truth.state, truth.mask))
