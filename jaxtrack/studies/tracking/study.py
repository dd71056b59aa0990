"""Study of the clustering-statistic Hough transform (2018), section V-B: targets come and go.

Tables 8 to 13 of the paper: every rate of false alarms and misses, every noise, for the window
tracker with the joint vote and with the paper's, for the paper's Kalman tracker and a sensible one,
beside a floor that knows which detection is whose. Errors are against what the sonar can see and
against the paper's own table 7, which keeps targets that have left the sector.
"""

import functools
import time
from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

import jax
import numpy as np
import xarray as xr

from jaxtrack.models import BeamSonar
from jaxtrack.sensors import observe_beams
from jaxtrack.studies import parts, store
from jaxtrack.studies.csht.cells import CELLS, Rates
from jaxtrack.studies.csht.report import cell_name
from jaxtrack.studies.csht.trial import BEAM_COUNT
from jaxtrack.studies.registry import Context, Study
from jaxtrack.studies.tables import SMOKE_BELOW, entry, failed_table
from jaxtrack.studies.tracking import figures
from jaxtrack.studies.tracking import report as tracking_report
from jaxtrack.studies.tracking.trackers import FLOOR, TO_THE_LETTER, TRACKERS, track
from jaxtrack.studies.tracking.trial import (
    TRUTHS,
    Inputs,
    Outcome,
    Scores,
    generated_trial,
    inputs_of,
    scores_of,
    trial,
)
from jaxtrack.types import Key

VARIANTS = {"literal": "per_beam", "one a scan": "per_scan"}
SMOKE_CELLS = (Rates(0.3, 0.3, 3.0), Rates(0.5, 0.5, 3.0))
_TABLE_7, _GENERATED, _TIMED = range(3)  # streams of random keys


class Shown(NamedTuple):
    """One run that figures show, by tracker: positions [T, M, 2] and what is reported [T, M]."""

    truth: Any
    tracks: Mapping[str, tuple[np.ndarray, np.ndarray]]


def run(context: Context) -> None:
    """Run everything, print the tables, save results and figures."""
    say = context.console.print
    # A smoke run leaves most out: each is a program of its own to compile.
    smoke = context.trials < SMOKE_BELOW
    cells = SMOKE_CELLS if smoke else CELLS
    tables: dict[str, xr.Dataset] = {}
    for place, (name, false_alarms) in enumerate(VARIANTS.items()):
        if smoke and name != "literal":
            continue
        key = context.key(_TABLE_7, place)
        outcomes = []
        for done, cell in enumerate(cells, start=1):
            what = f"{name}, {cell_name(*cell)}"
            fn = trial(false_alarms)
            outcomes.append(parts.run_part(context, what, fn, key, context.trials, inputs_of(cell)))
            context.progress(name, done, len(cells))
        tables[name] = dataset(outcomes, cells)
        for table in tracking_report.tables(tables[name], name):
            say(table)
        say(tracking_report.consistency(tables[name], name))
        say(tracking_report.overflow(tables[name]))
        say(tracking_report.full(tables[name]))
    generated = None
    if not smoke:
        report = functools.partial(context.progress, "generated scenes")
        one = Rates(0.3, 0.3, 3.0)
        outcome = parts.run_part(
            context,
            "generated",
            generated_trial,
            context.key(_GENERATED),
            context.trials,
            inputs_of(one).scene.sonar,
            report,
        )
        generated = dataset([outcome], (one,))
        say(tracking_report.generated(generated))
        say(tracking_report.to_the_letter(_to_the_letter(context)))
        say(tracking_report.times(seconds_a_look(context)))
    rows = tracking_report.marks(tables["literal"], generated)
    say(failed_table("Marks, fixed beforehand", rows))
    summary = {
        "study": STUDY.name,
        "source": STUDY.source,
        "seed": context.seed,
        "trials": context.trials,
        "marks": [entry(row) for row in rows],
    }
    saved = {name.replace(" ", "_"): table for name, table in tables.items()}
    store.save(
        context.out, saved if generated is None else saved | {"generated": generated}, summary
    )
    report = functools.partial(context.progress, "figures")
    shown = _shown(context.key(_TABLE_7, 0), Rates(0.5, 0.5, 3.0))
    figures.draw(context.out, tables, shown, report)
    parts.forget_parts(context)


def dataset(outcomes: Sequence[Outcome], cells: Sequence[Rates]) -> xr.Dataset:
    """Return labelled scores, [cell, trial, truth, tracker, look]."""
    names = (*TRACKERS, FLOOR)
    dims = ("cell", "trial", "truth", "tracker", "look")
    score = lambda outcome, field: np.stack(
        [
            np.stack([getattr(outcome.scores[truth][name], field) for name in names], 1)
            for truth in TRUTHS
        ],
        1,
    )
    each = lambda field: np.stack([score(outcome, field) for outcome in outcomes])
    values = {
        field: (dims, each(field).astype(np.float32), {"units": "m"}) for field in Scores._fields
    }
    by_tracker = lambda read: np.stack(
        [np.stack([read(outcome, name) for name in names], 1) for outcome in outcomes]
    )
    agreed = lambda field: by_tracker(lambda one, name: getattr(one.consistency[name], field))
    one = ("cell", "trial", "tracker", "look")
    rates = {name: ("cell", [getattr(c, name) for c in cells]) for name in Rates._fields}
    return xr.Dataset(
        {
            **values,
            "nees": (one, agreed("nees").astype(np.float32)),
            "own": (one, agreed("own")),
            "strays": (one, agreed("strays")),
            "full": (one, by_tracker(lambda outcome, name: outcome.full[name])),
            "overflow": (("cell", "trial", "look"), np.stack([o.overflow for o in outcomes])),
            "quiet": (("cell", "trial", "look"), np.stack([o.quiet for o in outcomes])),
        },
        coords={"truth": list(TRUTHS), "tracker": list(names), **rates},
    )


def seconds_a_look(context: Context) -> dict[str, float]:
    """Return how long each tracker takes a look, compiled, at P_M = P_F = 0.5 as in the paper."""
    scene, _ = inputs_of(Rates(0.5, 0.5, 3.0))
    looks = jax.jit(lambda key: observe_beams(key, *scene, beams=BEAM_COUNT))(context.key(_TIMED))
    found = {}
    for place, name in enumerate(TRACKERS, start=1):
        alone = jax.jit(functools.partial(_count, name))
        jax.block_until_ready(alone(looks, scene.sonar))
        begun = time.perf_counter()
        jax.block_until_ready(alone(looks, scene.sonar))
        found[name] = (time.perf_counter() - begun) / len(looks.time_s)
        context.progress("time a look", place, len(TRACKERS))
    return found


def _count(name: str, looks: Any, sonar: BeamSonar) -> Any:
    return track(name, looks, sonar, "per_beam", 6)[0].mask.sum()


def _to_the_letter(context: Context) -> np.ndarray:
    """Return run by run the mean OSPA of the paper's Kalman tracker with X₀ = 0, at .3, .3."""

    def run(key: Key, inputs: Inputs) -> Any:
        scans = observe_beams(key, *inputs.scene, beams=BEAM_COUNT)
        found, _ = track(TO_THE_LETTER, scans, inputs.scene.sonar, "per_beam", 6)
        return scores_of(found, inputs.visible).distance.mean()

    cell = inputs_of(Rates(0.3, 0.3, 3.0))
    key = context.key(_TABLE_7, 0)
    return parts.run_part(context, TO_THE_LETTER, run, key, context.trials, cell)


def _shown(key: Key, cell: Rates) -> Shown:
    scene, visible = inputs_of(cell)

    @jax.jit
    def run(key: Key) -> Any:
        looks = observe_beams(jax.random.fold_in(key, 0), *scene, beams=BEAM_COUNT)
        return {name: track(name, looks, scene.sonar, "per_beam", 6)[0] for name in TRACKERS}

    found = run(key)
    return Shown(
        jax.tree.map(np.asarray, visible),
        {
            name: (np.asarray(found[name].mean)[..., :2], np.asarray(found[name].mask))
            for name in TRACKERS
        },
    )


STUDY = Study(
    name="csht_tracking",
    title="Clustering-statistic Hough transform: tracking targets that come and go",
    source="Yan et al., Clustering Statistic Hough Transform Based Estimation Method for Motion "
    "Elements of Multiple Underwater Targets, IEEE Access, 2018",
    trials_short=2,
    trials_full=100,
    seconds_short=60.0,
    seconds_full=12500.0,
    run=run,
)
