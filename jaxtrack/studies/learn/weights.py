"""Study of learning through the tracker: a network that gives each echo a weight.

In correlated, spiky clutter that the joint vote does not know, weights come from the best fixed
threshold, from a network trained on labels, from the same network that went on through the joint
vote, and from the true likelihood ratio, the ceiling. Threshold, bound of the weights and gate are
chosen for each on the same scenes; then all are scored on others. Beside it: which of a sonar's
specifications matters to the joint vote (`learn.sensitivity`).
"""

import functools
from collections.abc import Callable
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
import optax
import xarray as xr

from jaxtrack.studies import parts, store
from jaxtrack.studies.learn import sensitivity as learn_sensitivity
from jaxtrack.studies.learn import weights_report
from jaxtrack.studies.learn.weights_trial import (
    GATES,
    START_GATE,
    Network,
    Networks,
    label_loss,
    rates,
    score_with,
    settings,
    track_loss,
)
from jaxtrack.studies.registry import Context, Study
from jaxtrack.studies.tables import SMOKE_BELOW, entry, marks_table
from jaxtrack.tuning import FitResult, fit
from jaxtrack.types import Array, Key

LABELS, TRACKS = "labels", "tracks"
_LEARNING_RATES = 0.01, 0.003  # of the beginning, and of what comes then
_CLIP = 5.0
_FITS, _FIRST, _RATES, _CHOOSE, _SCORES, _SENSITIVITY = range(6)  # streams of random keys
_CHOOSING, _SCORING = "choosing the settings", "held-out scores"


class Effort(NamedTuple):
    """How much is simulated."""

    repeats: int  # networks of each kind, from other first values and on other scenes
    first_steps: int  # on labels, whatever comes then
    steps: int
    batch: int
    holdout: int
    every: int
    choosing: int  # scenes that threshold, k and gate are chosen on
    sensitivity: int  # scenes


FULL = Effort(3, 900, 300, batch=16, holdout=256, every=150, choosing=800, sensitivity=16000)
SMOKE = Effort(1, 2, 2, batch=2, holdout=2, every=1, choosing=4, sensitivity=16)


def run(context: Context) -> None:
    """Run everything, print the tables, save results and figures."""
    say = context.console.print
    if not is_installed():
        say("Flax is not installed (extra `learn`): there is no network to train.")
        return
    effort = FULL if context.trials >= SMOKE_BELOW else SMOKE
    network, firsts = _network(context, effort.repeats)
    fits = train(context, effort, network, firsts)
    scores = score(context, effort, network, fits)
    sensitivity = learn_sensitivity.measure(context, context.key(_SENSITIVITY), effort.sensitivity)
    say(weights_report.table(scores))
    say(weights_report.sensitivity_table(sensitivity))
    rows = weights_report.marks(scores)
    say(marks_table("Marks, fixed beforehand", rows))
    summary = {
        "study": STUDY.name,
        "source": STUDY.source,
        "seed": context.seed,
        "trials": context.trials,
        "effort": effort._asdict(),
        "marks": [entry(row) for row in rows],
    }
    store.save(context.out, {"scores": scores, "sensitivity": sensitivity}, summary)
    report = functools.partial(context.progress, "figures")
    weights_report.draw(context.out, scores, sensitivity, fits, report)
    parts.forget_parts(context)


def is_installed() -> bool:
    """Tell whether there is a Flax to make networks with."""
    try:
        import flax  # noqa: F401
    except ImportError:
        return False
    return True


def train(
    context: Context, effort: Effort, network: Network, firsts: list[Any]
) -> dict[tuple[str, int], FitResult]:
    """Return every network's training, by what it was trained on and its number.

    All begin on labels. From there one goes on with them, another goes through the joint vote: by
    as many steps, at the same rate, on the same scenes.
    """
    losses: dict[str, Callable[[Any, Key], Array]] = {
        LABELS: label_loss(network),
        TRACKS: track_loss(network),
    }

    def learn(method: str, start: Any, number: int, stage: int) -> FitResult:
        what = f"training on {method}, {number + 1}, {('first', 'then')[stage]}"
        steps = (effort.first_steps, effort.steps)[stage]
        gate = {"gate": START_GATE} if method == TRACKS else {}
        return fit(
            losses[method],
            {"network": start, **gate},
            optax.adam(optax.cosine_decay_schedule(_LEARNING_RATES[stage], steps)),
            key=context.key(_FITS, number, stage),
            steps=steps,
            batch=effort.batch,
            holdout=effort.holdout,
            clip=_CLIP,
            every=effort.every,
            micro_batch=2,
            checkpoint=parts.folder_of(context, what),
            progress=functools.partial(context.progress, what),
        )

    fits = {}
    for number, first in enumerate(firsts):
        start = learn(LABELS, first, number, 0).params["network"]
        for method in losses:
            fits[method, number] = learn(method, start, number, 1)
    return fits


def score(
    context: Context,
    effort: Effort,
    network: Network,
    fits: dict[tuple[str, int], FitResult],
) -> xr.Dataset:
    """Return OSPA on the scenes for choosing, [scene, setting, gate], and on held-out ones.

    There only what was chosen is scored; the rest is NaN.
    """
    stacked = [
        jax.tree.map(
            lambda *x: jnp.stack(x),
            *(fits[method, n].params["network"] for n in range(effort.repeats)),
        )
        for method in (LABELS, TRACKS)
    ]
    params = Networks(*stacked), rates(context.key(_RATES))
    methods, numbers, values = zip(*settings(effort.repeats), strict=True)

    def ospa(what: str, stream: int, trials: int, wanted: np.ndarray) -> np.ndarray:
        report = functools.partial(context.progress, what)
        key, fn, at = context.key(stream), score_with(network), (*params, wanted)
        return np.asarray(parts.run_part(context, what, fn, key, trials, at, report))

    tried = ospa(_CHOOSING, _CHOOSE, effort.choosing, np.ones(len(methods), bool))
    scores = xr.Dataset(
        {"ospa_choosing": (("scene", "setting", "gate"), tried, {"units": "m"})},
        coords={
            "method": ("setting", list(methods)),
            "network": ("setting", list(numbers)),
            "value": ("setting", list(values)),
            "gate": list(GATES),
        },
    )
    wanted = np.zeros(len(methods), bool)
    for places in weights_report.choices(scores).values():
        wanted[[setting for setting, _ in places]] = True
    found = ospa(_SCORING, _SCORES, context.trials, wanted)
    return scores.assign(ospa=(("trial", "setting", "gate"), found, {"units": "m"}))


def _network(context: Context, repeats: int) -> tuple[Network, list[Any]]:
    """Return the network as a function of looks, and first arrays for each repeat."""
    from jaxtrack.studies.learn.network import echo_network, features_of
    from jaxtrack.studies.learn.weights_trial import SONAR

    made = [echo_network(context.key(_FIRST, number)) for number in range(repeats)]
    apply = made[0][1]
    network = lambda arrays, scans: apply(arrays, features_of(scans, SONAR.range_max_m))
    return network, [params for params, _ in made]


STUDY = Study(
    name="learn_weights",
    title="Learning through the tracker: weights of echoes; which specification of a sonar matters",
    source="this library",
    trials_short=2,
    trials_full=2000,
    seconds_short=60.0,
    seconds_full=300.0,
    run=run,
)
