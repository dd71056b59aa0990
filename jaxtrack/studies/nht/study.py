"""Study of the neutrosophic Hough transform (2018): its experiments, and what really works there.

Four situations (I ideal, II noise of 10 m, III clutter, IV both) with 10 and 56 clutter a scan, and
the paper's real radar data with 10. The paper's four methods, wider readings of the neutrosophic
one, and the joint space–time vote look at the same scans. All settings below were fixed in advance.
"""

import concurrent.futures
import functools

import jax
import jax.numpy as jnp
import xarray as xr

from jaxtrack.montecarlo import monte_carlo
from jaxtrack.studies import parts, store
from jaxtrack.studies.nht import figures, marks, scores
from jaxtrack.studies.nht import report as nht_report
from jaxtrack.studies.nht import times as nht_times
from jaxtrack.studies.nht.scenes import Inputs, real_inputs, simulated_inputs
from jaxtrack.studies.nht.scores import Cell, Gates, derive_gates
from jaxtrack.studies.nht.trial import Outcome, Shape, shapes_for, trial
from jaxtrack.studies.registry import Context, Study
from jaxtrack.studies.tables import entry, marks_table
from jaxtrack.types import Key

MATCH_M, REAL_MATCH_M = (50.0, 100.0), (150.0, 300.0)
# Situation → the clutter that methods expect and gates are made for: a detector does not know that
# there is none. 56 a scan is the paper's 10 a square kilometre, and primary.
SITUATIONS = {"I": 10, "II": 10, "III-10": 10, "IV-10": 10, "III-56": 56, "IV-56": 56}
PRIMARY = {"I": "I", "II": "II", "III": "III-56", "IV": "IV-56"}
REAL = {"real": 0.0, "real + 10 m": 10.0}  # noise added
# Run times beside those of the situations; for these, arrays have to be compiled anew, so a run of
# fewer trials leaves them out.
MORE_CLUTTER, MORE_FROM = (0.0, 28.0, 112.0), 500
_GATES, _TRIALS, _TIMES = range(3)  # streams of random keys


def run(context: Context) -> None:
    """Run everything, print the tables, save results and figures."""
    say = context.console.print
    gates, scenes = derive(context)
    cells = simulate_all(context, gates)
    times = run_times(context, cells)
    simulated = scores.dataset([cells[name] for name in SITUATIONS], MATCH_M)
    real = scores.dataset([cells[name] for name in REAL], REAL_MATCH_M)
    tables = {
        "gates": scores.gates_dataset(gates, scenes),
        "simulated": simulated,
        "real": real,
        "times": times,
    }
    say(nht_report.gates(tables["gates"]))
    for what, count, match_m in (
        ("Top 3 at 50 m", "top_k", 50.0),
        ("Top 3 at 100 m", "top_k", 100.0),
        ("Perfect at 50 m", "perfect", 50.0),
    ):
        say(nht_report.shares(simulated, what, count=count, match_m=match_m))
    title = "Found / false / redundant lines a run, errors of ρ and θ of those found, at 50 m"
    say(nht_report.means(simulated, title, match_m=50.0))
    say(nht_report.table_2(simulated, PRIMARY))
    for match_m in REAL_MATCH_M:
        title = f"Real data, top 3 at {match_m:.0f} m"
        say(nht_report.shares(real, title, count="top_k", match_m=match_m))
    say(nht_report.run_times(times))
    rows = marks.rows(simulated, real)
    say(marks_table("Marks, fixed beforehand", rows))

    named = {name: {" ".join(at): gate for at, gate in x.items()} for name, x in gates.items()}
    summary = {
        "study": STUDY.name,
        "source": STUDY.source,
        "seed": context.seed,
        "trials": context.trials,
        "gates": named,
        "marks": [entry(row) for row in rows],
    }
    store.save(context.out, tables, summary)
    shown = {name: cells[ours] for name, ours in {**PRIMARY, "real": "real + 10 m"}.items()}
    report = functools.partial(context.progress, "figures")
    figures.draw(context.out, shown, tables, report)
    parts.forget_parts(context)


def derive(context: Context) -> tuple[dict[str, Gates], int]:
    """Return the gates by table of clutter, from scenes without targets, and how many scenes."""
    scenes = min(2 * context.trials, 2000)
    _compile(context)
    gates = {}
    for place, (name, shape) in enumerate(shapes_for(context.trials).items()):
        inputs = real_inputs(0.0) if name == "real" else _situation(f"IV-{name}", 0.0)
        nobody = inputs.truth._replace(mask=jnp.zeros_like(inputs.truth.mask))
        what = f"gates, clutter {name}"
        key = context.key(_GATES, place)
        outcome = _run(context, what, shape, key, scenes, inputs._replace(truth=nobody))
        gates[name] = derive_gates(outcome)
    return gates, scenes


def simulate_all(context: Context, gates: dict[str, Gates]) -> dict[str, Cell]:
    """Return the trials of every situation."""
    cells, shapes = {}, shapes_for(context.trials)
    for place, situation in enumerate((*SITUATIONS, *REAL)):
        name = str(SITUATIONS.get(situation, "real"))
        gate = gates[name]["joint", "raw"]
        recorded = situation in REAL
        inputs = real_inputs(REAL[situation], gate) if recorded else _situation(situation, gate)
        key = context.key(_TRIALS, place)
        outcome = _run(context, situation, shapes[name], key, context.trials, inputs)
        cells[situation] = Cell(situation, shapes[name], inputs, key, gates[name], outcome)
    return cells


def run_times(context: Context, cells: dict[str, Cell]) -> xr.Dataset:
    """Return the run times on the first scans of situation IV, of the real data, and of others."""

    def setting(name: str) -> nht_times.Setting:
        cell = cells[name]
        scans = jax.tree.map(lambda x: jnp.asarray(x[: nht_times.RUNS]), cell.outcome.scans)
        return nht_times.Setting(float(cell.inputs.radar.clutter_per_scan), *cell[1:3], scans)

    settings = [setting("IV-10"), setting("IV-56")]
    if context.trials >= MORE_FROM:
        for clutter in MORE_CLUTTER:
            inputs = simulated_inputs("IV", clutter, clutter)
            settings.append(nht_times.simulated(context.key(_TIMES), clutter, inputs))
    settings.sort(key=lambda setting: setting.clutter)
    report = functools.partial(context.progress, "run times")
    return nht_times.measure(settings, setting("real + 10 m"), report)


def _situation(name: str, joint_gate: float) -> Inputs:
    clutter = float(SITUATIONS[name])
    return simulated_inputs(name.partition("-")[0], clutter, clutter, joint_gate)


def _run(
    context: Context, what: str, shape: Shape, key: Key, trials: int, inputs: Inputs
) -> Outcome:
    report = functools.partial(context.progress, what)
    return parts.run_part(context, what, trial(shape), key, trials, inputs, report)


def _compile(context: Context) -> None:
    """Compile all programs at a time, by a first trial of each: one alone leaves cores idle."""
    named = {shape: name for name, shape in shapes_for(context.trials).items()}

    def first(shape: Shape) -> None:
        name = named[shape]
        inputs = real_inputs(0.0) if name == "real" else _situation(f"IV-{name}", 0.0)
        monte_carlo(trial(shape), context.key(), 1, inputs, micro_batch=1)

    with concurrent.futures.ThreadPoolExecutor(len(named)) as pool:
        for done, _ in enumerate(pool.map(first, named), start=1):
            context.progress("compiling", done, len(named))


STUDY = Study(
    name="nht",
    title="Neutrosophic Hough transform: crossing targets in noise and clutter, real radar data",
    source="Fan et al., Neutrosophic Hough Transform-Based Track Initiation Method for Multiple "
    "Target Tracking, IEEE Access, 2018",
    trials_short=20,
    trials_full=2000,
    seconds_short=100.0,
    seconds_full=3300.0,
    run=run,
)
