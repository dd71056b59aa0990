"""Study of the cloud-like model (2019): two targets that meet, tracked by every associator.

The paper gives no numbers to compare with, only the plots of single runs. So its claim, that the
cloud model keeps tracks apart where others exchange or lose them, is tried on a stated experiment:
six situations, and sweeps over angle, echoes, clutter and detection probability. Three situations
are looked at by the paper's sonar too, whose pings are simulated: what stands over a threshold are
the echoes. All associators see the same looks and start at the same known tracks.
"""

import functools
from collections.abc import Mapping
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
import xarray as xr

from jaxtrack.sensors import EchoSensor, Meeting, Situation, situations
from jaxtrack.studies import parts, store
from jaxtrack.studies.ccm import figures
from jaxtrack.studies.ccm import report as ccm_report
from jaxtrack.studies.ccm.looks import SOURCES, known_of
from jaxtrack.studies.ccm.trial import METHODS, SHOWN, Inputs, Outcome, look, trial
from jaxtrack.studies.registry import Context, Study
from jaxtrack.studies.tables import entry, marks_table

LEAST_CLUTTER = 1e-3  # β₀ a square metre: what associators assume where there is less
LEAST_GRID = (1e-4, 1e-2, 1e-1, 1.0)  # others, in the situations without clutter
_KEY = 0  # of all cells: those of one situation see the same looks, all others the same draws
_DEGREE = float(jnp.pi) / 180
_CONTENTS = dict.fromkeys(("detected", "echoes", "false_per_look"), ("cell", "trial")) | {
    "echo_squared_m2": ("cell", "trial", "axis")
}


class Cell(NamedTuple):
    """One column of the experiment."""

    situation: Situation
    least_clutter_per_m2: float = LEAST_CLUTTER
    source: str = "echoes"


def pinged() -> dict[str, Cell]:
    """Return the cells that the sonar looks at.

    Example:
        >>> print(*pinged(), sep="; ")
        A, pings; A3, pings; B, pings; A, centroids; B, centroids
    """
    named = situations()
    at = [(name, "pings") for name in ("A", "A3", "B")] + [(name, "centroids") for name in "AB"]
    return {f"{name}, {source}": Cell(named[name], source=source) for name, source in at}


def assumed() -> dict[str, dict[str, float]]:
    """Return the cells of each situation without clutter, by the β₀ that is assumed there.

    Example:
        >>> assumed()["A3"]
        {'A3': 0.001, 'A3, β₀ 0.0001': 0.0001, 'A3, β₀ 0.01': 0.01, 'A3, β₀ 0.1': 0.1, 'A3, β₀ 1': 1.0}
    """  # noqa: E501
    others = lambda name: {f"{name}, β₀ {least:g}": least for least in LEAST_GRID}
    return {name: {name: LEAST_CLUTTER} | others(name) for name in ("A", "A3", "B")}


def cells() -> dict[str, Cell]:
    """Return every cell by name: situations, other β₀, sweeps around situation C, and the sonar's.

    Example:
        >>> list(cells())[:7]
        ['A', 'A3', 'B', 'C', 'D', 'E', 'A, β₀ 0.0001']
    """
    named = situations()
    found = {name: Cell(situation) for name, situation in named.items()}
    for name, others in assumed().items():
        found |= {cell: Cell(named[name], least) for cell, least in others.items()}
    crossing = lambda degrees, **sensor: Cell(
        Situation(Meeting(degrees * _DEGREE), EchoSensor(clutter_per_m2=0.02)._replace(**sensor))
    )
    for degrees in (15.0, 45.0, 90.0):
        found[f"angle {degrees:g}°"] = crossing(degrees)
    for echoes in (1.0, 2.0, 8.0):
        found[f"echoes {echoes:g}"] = crossing(60.0, echoes=echoes)
    for clutter in (0.005, 0.01, 0.04):
        found[f"clutter {clutter:g}"] = crossing(60.0, clutter_per_m2=clutter)
    for p_detect in (0.5, 0.7, 1.0):
        found[f"P_D {p_detect:g}"] = crossing(60.0, p_detect=p_detect)
    return found | pinged()


def run(context: Context) -> None:
    """Run everything, print the tables, save results and figures."""
    say = context.console.print
    every = cells()
    outcomes = compute(context, every)
    scores = dataset(outcomes)
    for table in ccm_report.tables(scores, list(situations()), list(pinged()), assumed()):
        say(table)
    rows = ccm_report.marks(scores, assumed())
    say(marks_table("Marks, fixed beforehand", rows))
    compared = [*situations(), *pinged()]
    summary = {
        "study": STUDY.name,
        "source": STUDY.source,
        "seed": context.seed,
        "trials": context.trials,
        "marks": [entry(row) for row in rows],
        "claims": [claim.entry() for claim in ccm_report.claims(scores, compared)],
        "best_least_clutter_per_m2": ccm_report.at_best(scores, assumed())[1],
    }
    store.save(context.out, {"scores": scores}, summary)
    # Compiled in half the time: it is called six times.
    seen = jax.jit(look, compiler_options={"xla_backend_optimization_level": 0})
    first = jax.random.fold_in(context.key(_KEY), 0)
    looks = {name: seen(first, _inputs(every[name])) for name in figures.SHOWN_CELLS}
    paths_m = {
        name: {method: np.asarray(outcomes[name].paths_m[method])[0] for method in SHOWN}
        for name in figures.SHOWN_CELLS
    }
    progress = functools.partial(context.progress, "figures")
    figures.draw(context.out, looks, paths_m, scores, progress)
    parts.forget_parts(context)


def compute(context: Context, every: Mapping[str, Cell]) -> dict[str, Outcome]:
    """Return all trials of all cells; the same trial of two cells has the same key."""
    outcomes: dict[str, Outcome] = {}
    for name, cell in every.items():
        report = functools.partial(context.progress, name)
        part = name.replace("/", " ")
        outcomes[name] = parts.run_part(
            context, part, trial, context.key(_KEY), context.trials, _inputs(cell), report
        )
    return outcomes


def dataset(outcomes: Mapping[str, Outcome]) -> xr.Dataset:
    """Return labelled scores, [cell, trial, associator] and of squared errors [..., look] means."""
    each = lambda field: np.stack(
        [
            np.stack([np.asarray(getattr(o.scores[name], field)) for name in METHODS], axis=1)
            for o in outcomes.values()
        ]
    )
    dims = ("cell", "trial", "associator")
    squared = each("squared_m2")  # [cell, trial, method, look]
    return xr.Dataset(
        {
            "swap": (dims, each("swap")),
            "loss": (dims, each("loss")),
            "squared_m2": (dims, squared.mean(-1), {"units": "m²"}),
            "squared_by_look_m2": (
                ("cell", "associator", "look"),
                squared.mean(1),
                {"units": "m²"},
            ),
            "squared_by_look_se_m2": (
                ("cell", "associator", "look"),
                squared.std(1) / np.sqrt(squared.shape[1]),
                {"units": "m²"},
            ),
            "nees": (dims, each("nees")),
            "overflow": (dims[:2], np.stack([o.overflow for o in outcomes.values()])),
            **{
                name: (axes, np.stack([getattr(o.contents, name) for o in outcomes.values()]))
                for name, axes in _CONTENTS.items()
            },
        },
        coords={"cell": list(outcomes), "associator": list(METHODS), "axis": ["x", "y"]},
    )


def _inputs(cell: Cell) -> Inputs:
    known = known_of(cell.source, cell.situation.sensor)
    source = SOURCES.index(cell.source)
    inputs = Inputs(cell.situation, source, known, cell.least_clutter_per_m2)
    return jax.tree.map(jnp.asarray, inputs)


STUDY = Study(
    name="ccm",
    title="Cloud-model association: two targets that meet, several echoes a look, in clutter",
    source="Sheng et al., Clustering Cloud-Like Model-Based Targets Underwater Tracking for AUVs, "
    "Sensors, 2019",
    trials_short=20,
    trials_full=1000,
    seconds_short=50.0,
    seconds_full=300.0,
    run=run,
)
