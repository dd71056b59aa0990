"""Study of the Zernike moment paper (2023): a bucket before a mechanically scanned sonar.

Its three experiments, each in open water and with two objects beside the path; Hu's moments, the
paper's set of Zernike's and one of low orders, origins at the particle and at the centroid, plain
and optimised transition, and a tracker of our own. Sweeps over the target's step a frame, and over
the distance of the objects. All see the same sweeps, and start where the operator picks the target.
"""

import functools
from collections.abc import Mapping
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
import xarray as xr

from jaxtrack.sensors import DraggedBucket
from jaxtrack.studies import parts, store
from jaxtrack.studies.moment import figures
from jaxtrack.studies.moment import report as moment_report
from jaxtrack.studies.moment.report import cell_name
from jaxtrack.studies.moment.trial import (
    METHODS,
    SCENES,
    SIDE_M,
    Inputs,
    Outcome,
    Seen,
    Track,
    begin,
    track_all,
    trial,
)
from jaxtrack.studies.registry import Context, Study
from jaxtrack.studies.tables import SMOKE_BELOW, entry, marks_table
from jaxtrack.types import Key

_DIKE_M = 80.0  # in sweeps, for fast targets go far
_FRAME_S = 6.06
_FEWER = 4  # a sweep's cell has so many times fewer runs than a scene's


class Cell(NamedTuple):
    """One column of the experiment."""

    motion: str
    surroundings: str
    bucket: DraggedBucket = DraggedBucket()


def scenes() -> dict[str, Cell]:
    """Return the six scenes by name.

    Example:
        >>> list(scenes())[:2]
        ['static, clean', 'hovering, clean']
    """
    order = sorted(SCENES, key=lambda scene: scene[1])
    return {cell_name(*scene): Cell(*scene) for scene in order}


def sweeps() -> dict[str, Cell]:
    """Return the sweeps' cells by name: steps in open water, and distances of the objects.

    Example:
        >>> list(sweeps())[:2]
        ['step 0.3 m', 'step 0.9 m']
    """
    found = {}
    for step_m in (0.3, 0.9, 1.2, 1.5):
        bucket = DraggedBucket(speed_m_s=step_m / _FRAME_S, dike_m=_DIKE_M)
        found[f"step {step_m:g} m"] = Cell("following", "clean", bucket)
    for aside_m in (1.0, 1.5, 3.0, 4.0):
        bucket = DraggedBucket(clutter_m=aside_m)
        found[f"objects at {aside_m:g} m"] = Cell("hovering", "two_objects", bucket)
    return found


def run(context: Context) -> None:
    """Run everything, print the tables, save results and figures."""
    say = context.console.print
    # Sweeps are more of the same program: a smoke run shows nothing by them.
    smoke = context.trials < SMOKE_BELOW
    found = {"scenes": _table(context, scenes(), context.trials, 0)}
    if not smoke:
        found["sweeps"] = _table(context, sweeps(), max(context.trials // _FEWER, SMOKE_BELOW), 1)
    scores = found["scenes"]
    for table in moment_report.tables(scores, found.get("sweeps")):
        say(table)
    full = scores.overflow.mean().item(), scores.crowded.mean().item()
    say(f"Runs with more points than places: {full[0]:.3f} around particles, {full[1]:.3f} in all")
    rows = moment_report.marks(scores, found.get("sweeps"))
    say(marks_table("Marks, fixed beforehand", rows))
    summary = {
        "study": STUDY.name,
        "source": STUDY.source,
        "seed": context.seed,
        "trials": context.trials,
        "marks": [entry(row) for row in rows],
        "claims": {
            claim: {cell: word for cell, (word, _) in verdicts.items()}
            for claim, verdicts in moment_report.claims(scores).items()
        },
    }
    store.save(context.out, found, summary)
    shown = jax.jit(_shown)
    runs = {}
    for name in list(figures.SHOWN)[-1:] if smoke else figures.SHOWN:
        key = jax.random.fold_in(context.key(list(scenes()).index(name)), 0)
        runs[name] = jax.tree.map(np.asarray, shown(key, _inputs(scenes()[name])))
    report = functools.partial(context.progress, "figures")
    figures.draw(context.out, runs, report)
    parts.forget_parts(context)


def _table(context: Context, cells: Mapping[str, Cell], trials: int, group: int) -> xr.Dataset:
    """Return the scores of cells, each with random numbers of its own."""
    outcomes: dict[str, Outcome] = {}
    for place, (name, cell) in enumerate(cells.items()):
        key = context.key(place + group * len(SCENES))
        report = functools.partial(context.progress, name)
        outcomes[name] = parts.run_part(context, name, trial, key, trials, _inputs(cell), report)
    return dataset(outcomes)


def dataset(outcomes: Mapping[str, Outcome]) -> xr.Dataset:
    """Return labelled errors, [cell, trial, tracker, look, axis]."""
    each = lambda field: np.stack([np.asarray(getattr(o, field)) for o in outcomes.values()])
    error_m = each("error_m")
    beside_m = error_m - SIDE_M * each("away")[:, :, None]
    dims = ("cell", "trial", "tracker", "look", "axis")
    return xr.Dataset(
        {
            "error_m": (dims, error_m, {"units": "m"}),
            "side_error_m": (dims, beside_m.astype(error_m.dtype), {"units": "m"}),
            "crossed": (("cell", "trial", "look"), each("crossed")),
            "overflow": (("cell", "trial", "tracker"), each("overflow")),
            "crowded": (("cell", "trial"), each("crowded")),
        },
        coords={"cell": list(outcomes), "tracker": list(METHODS), "axis": ["x", "y"]},
    )


def _shown(key: Key, inputs: Inputs) -> tuple[Seen, dict[str, Track]]:
    shown = begin(key, inputs)
    return shown.seen, track_all(shown, ("hu", "zernike"))


def _inputs(cell: Cell) -> Inputs:
    place = SCENES.index((cell.motion, cell.surroundings))
    return jax.tree.map(jnp.asarray, Inputs(place, cell.bucket))


STUDY = Study(
    name="moment_tracking",
    title="Particle filter on moment features: a bucket before a mechanically scanned sonar",
    source="Gao et al., Research on an Underwater Target-Tracking Method Based on Zernike Moment "
    "Feature Matching, J. Mar. Sci. Eng., 2023",
    trials_short=2,
    trials_full=200,
    seconds_short=40.0,
    seconds_full=800.0,
    run=run,
)
