"""Study of the clustering-statistic Hough transform (2018): motion elements from one sonar window.

Tables 3 to 6 of the paper: every rate of false alarms and misses, every noise, for the standard
vote (SHT), the paper's (CSHT) and the joint vote, beside the floor, least squares with known
association, and the paper's figures. The false alarms are the paper's literal ones (P_F a beam),
those with clutter in missed beams too, or one a scan. All settings were fixed in advance.
"""

import functools
from collections.abc import Callable, Sequence
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import xarray as xr

from jaxtrack.hough import gate_for_false_rate
from jaxtrack.models import BeamSonar
from jaxtrack.montecarlo import monte_carlo
from jaxtrack.sensors import (
    SonarScene,
    SonarSceneLimits,
    motion_elements_scene,
    random_sonar_scene,
)
from jaxtrack.studies import parts, store
from jaxtrack.studies.csht import figures
from jaxtrack.studies.csht import report as csht_report
from jaxtrack.studies.csht.cells import (
    CELLS,
    LEAST_GATE,
    VARIANTS,
    Rates,
    shipped_gates,
    sonar_of,
)
from jaxtrack.studies.csht.paper import SIGMAS_M
from jaxtrack.studies.csht.trial import (
    CUTOFF,
    KNOWN,
    METHODS,
    ORDER,
    Inputs,
    Outcome,
    search,
    trial,
    vote_counts,
)
from jaxtrack.studies.registry import Context, Study
from jaxtrack.studies.tables import SMOKE_BELOW, entry, failed_table
from jaxtrack.types import Key

FALSE_PER_RUN = 0.02  # tracks of the joint vote in a window without targets
SCENES, SHIPPED_SCENES = 500, 200  # windows without targets that a gate comes from
DERIVE_FROM = 500  # trials; shorter runs take the gates that are shipped
_GATES, _TABLE_2, _GENERATED = range(3)  # streams of random keys
MOST_TARGETS = 5  # of generated scenes


def run(context: Context) -> None:
    """Run everything, print the tables, save results and figures."""
    say = context.console.print
    derive = context.trials >= DERIVE_FROM
    gates = derive_gates(context) if derive else shipped_gates()
    few = max(context.trials // 5, min(context.trials, SMOKE_BELOW))
    table_2 = {}
    for place, name in enumerate(VARIANTS):
        key = context.key(_TABLE_2, place)
        trials = context.trials if name == "literal" else few
        table_2[name] = _part(context, key, trials, name, motion_elements_scene(), gates[name])
    generated = outside = None
    # A smoke run leaves these out: they are a program of their own to compile.
    if context.trials >= SMOKE_BELOW:
        key = context.key(_GENERATED)
        every = _part(context, key, context.trials, "literal", None, gates["literal"])
        within = every.within.values[0]  # the same scenes in every cell
        generated, outside = every.isel(trial=within), every.isel(trial=~within)
    else:
        say(f"Generated scenes are left out: they need at least {SMOKE_BELOW} trials.")
    scenes = SCENES if derive else SHIPPED_SCENES
    say(csht_report.gates(CELLS, gates, scenes, FALSE_PER_RUN))
    shown = [(f"Table 2 scene, false alarms: {name}", table) for name, table in table_2.items()]
    shown += [("Generated scenes", generated), ("Generated scenes that break a limit", outside)]
    for title, table in shown:
        if table is not None and table.sizes["trial"]:
            for part in csht_report.errors(table, title):
                say(part)
    say(csht_report.effective_samples(table_2["literal"]))
    say(csht_report.overflow(table_2["literal"]))
    rows = csht_report.marks(table_2, generated, outside)
    say(failed_table("Marks, fixed beforehand", rows))
    say(
        csht_report.vote_counts({name: _votes(context, name) for name in ("literal", "one a scan")})
    )
    summary = {
        "study": STUDY.name,
        "source": STUDY.source,
        "seed": context.seed,
        "trials": context.trials,
        "false_per_run": FALSE_PER_RUN,
        "ospa": {"order": ORDER, "cutoff_m": CUTOFF, "cutoff_m_s": CUTOFF},
        "gates": gates,
        "marks": [entry(row) for row in rows],
    }
    tables = {name.replace(" ", "_"): table for name, table in table_2.items()}
    if generated is not None and outside is not None:
        tables |= {"generated": generated, "generated_outside": outside}
    store.save(context.out, tables, summary)
    report = functools.partial(context.progress, "figures")
    figures.draw(context.out, table_2, context.key(), report)
    parts.forget_parts(context)


def derive_gates(context: Context, scenes: int = SCENES) -> dict[str, list[float]]:
    """Return the joint vote's gate in every cell of each model, from windows without targets."""
    scene = motion_elements_scene()
    nobody = scene.truth._replace(mask=jnp.zeros_like(scene.truth.mask))
    gates: dict[str, list[float]] = {}
    for place, (name, variant) in enumerate(VARIANTS.items()):
        key = context.key(_GATES, place)
        gates[name] = []
        for done, cell in enumerate(CELLS, start=1):
            # With the least gate: what is weaker takes nothing from the others there either.
            empty = SonarScene(nobody, scene.pose, sonar_of(name, cell))
            inputs = Inputs(empty, jnp.asarray(LEAST_GATE))
            find = search(variant.false_alarms)
            what = f"gates, {name}, {csht_report.cell_name(*cell)}"
            found = parts.run_part(context, what, find, key, scenes, inputs)
            score, mask = (jnp.asarray(x) for x in found)
            gate = float(gate_for_false_rate(score, mask, FALSE_PER_RUN))
            gates[name].append(round(max(gate, LEAST_GATE), 3))
            context.progress(f"gates, {name}", done, len(CELLS))
    return gates


def _votes(context: Context, variant: str) -> tuple[float, float]:
    """Return mean votes of the true lines' cells, and of the strongest cell away from them."""
    scene = motion_elements_scene()._replace(sonar=sonar_of(variant, Rates(0.3, 0.3, 3.0)))
    count = vote_counts(VARIANTS[variant].false_alarms)
    own, other = monte_carlo(count, context.key(_TABLE_2), 64, scene, micro_batch=1).mean
    return float(own), float(other)


def _part(
    context: Context,
    key: Key,
    trials: int,
    variant: str,
    scene: SonarScene | None,
    gates: Sequence[float],
) -> xr.Dataset:
    """Return the errors of one model of false alarms, [cell, trial, estimator].

    Args:
        context: of the study.
        key: the same draws in every cell: what differs between cells is the cell.
        trials: a cell.
        variant: name of the model.
        scene: what is looked at; None: each trial generates its own.
        gates: of the joint vote, by cell.
    """
    what = f"generated, {variant}" if scene is None else variant
    outcomes = []
    for place, (cell, gate) in enumerate(zip(CELLS, gates, strict=True)):
        sonar, limit = sonar_of(variant, cell), jnp.asarray(gate)
        one: Callable[..., Outcome] = generated_trial
        inputs: Any = (sonar, limit)
        if scene is not None:
            one = trial(VARIANTS[variant].false_alarms)
            inputs = Inputs(scene._replace(sonar=sonar), limit)
        name = f"{what}, {csht_report.cell_name(*cell)}"
        outcomes.append(parts.run_part(context, name, one, key, trials, inputs))
        context.progress(what, place + 1, len(CELLS))
    return _dataset(outcomes)


def generated_trial(key: Key, inputs: tuple[BeamSonar, Any]) -> Outcome:
    """Return one trial on a scene of its own, with one to five targets."""
    sonar, gate = inputs
    draw, number, look = jax.random.split(key, 3)
    count = jax.random.randint(number, (), 1, MOST_TARGETS + 1)
    noisiest = sonar._replace(sigma_m=jnp.asarray(max(SIGMAS_M)))  # the same limits in every cell
    scene, within = random_sonar_scene(
        draw, noisiest, SonarSceneLimits(), targets=MOST_TARGETS, count=count
    )
    outcome = trial("per_beam")(look, Inputs(scene._replace(sonar=sonar), gate))
    return outcome._replace(within=within)


def _dataset(outcomes: Sequence[Outcome]) -> xr.Dataset:
    names = (*METHODS, *KNOWN)
    dims = ("cell", "trial", "estimator")
    stack = lambda field: np.stack(
        [np.stack([getattr(o.errors[name], field) for name in names], -1) for o in outcomes]
    )
    each = lambda field: (dims[:2], np.stack([getattr(o, field) for o in outcomes]))
    table = {
        "velocity_ospa": (dims, stack("velocity_m_s"), {"units": "m/s"}),
        "position_ospa": (dims, stack("position_m"), {"units": "m"}),
        "count": (dims, stack("count")),
        "targets": each("targets"),
        "passes_at_truth": each("passes_at_truth"),
        "overflow": each("overflow"),
        "effective_samples": each("effective_samples"),
        "within": each("within"),
    }
    rates = {name: ("cell", [getattr(c, name) for c in CELLS]) for name in Rates._fields}
    return xr.Dataset(table, coords={"estimator": list(names), **rates})


STUDY = Study(
    name="csht_estimation",
    title="Clustering-statistic Hough transform: motion elements of several targets from a sonar",
    source="Yan et al., Clustering Statistic Hough Transform Based Estimation Method for Motion "
    "Elements of Multiple Underwater Targets, IEEE Access, 2018",
    trials_short=5,
    trials_full=1200,
    seconds_short=80.0,
    seconds_full=3000.0,
    run=run,
)
