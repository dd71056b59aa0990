"""A study of tuning, from its cases to tables and figures."""

import functools
from collections.abc import Callable, Mapping

import xarray as xr

from jaxtrack.studies import parts, store
from jaxtrack.studies.registry import Context, Study
from jaxtrack.studies.tables import SMOKE_BELOW, Row, entry, marks_table
from jaxtrack.studies.tuned import report as tuned_report
from jaxtrack.studies.tuned import tpe
from jaxtrack.studies.tuned.scores import maps_of, score_all
from jaxtrack.studies.tuned.ways import Case, Effort, tune_all

SMOKE = Effort(steps=3, batch=2, holdout=2, every=2, grid=3, scenes=2)


def effort_of(trials: int, full: Effort) -> Effort:
    """Return the stated effort, or that of a run which only shows that everything works.

    Example:
        >>> effort_of(2, SMOKE._replace(steps=80)).steps
        3
    """
    return full if trials >= SMOKE_BELOW else SMOKE


def run_study(
    context: Context,
    study: Study,
    full: Effort,
    cases: Mapping[str, Case],
    words: tuned_report.Words,
    marks: Callable[[xr.Dataset], list[Row]],
) -> None:
    """Tune and score all cases, print tables, save results and figures; a short run takes one."""
    say = context.console.print
    effort = effort_of(context.trials, full)
    if effort is SMOKE:  # one case shows that everything works; each is compiled anew
        cases = dict([next(iter(cases.items()))])
    ways, fits = tune_all(context, effort, cases)
    if not tpe.is_installed():
        say("Optuna is not installed (extra `peers`): its columns are left out.")
    scores = score_all(context, cases, ways)
    maps = maps_of(context, effort, cases, scores)
    for name in cases:
        say(tuned_report.table(scores, name, words))
    rows = marks(scores)
    say(marks_table("Marks, fixed beforehand", rows))
    summary = {
        "study": study.name,
        "source": study.source,
        "seed": context.seed,
        "trials": context.trials,
        "effort": effort._asdict(),
        "marks": [entry(row) for row in rows],
    }
    store.save(context.out, {"scores": scores, **maps}, summary)
    report = functools.partial(context.progress, "figures")
    tuned_report.draw(context.out, scores, maps, ways, fits, words, report)
    parts.forget_parts(context)
