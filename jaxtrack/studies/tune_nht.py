"""Study of tuning by gradient: the two tolerances of the neutrosophic Hough transform.

In situation IV with 10 clutter a scan the paper's ε finds nothing. ε is tuned by the gradient of a
soft vote's candidate softmax, from the paper's values, a tenth and ten times, with ρ measured from
the field's corner and from its centre. Beside it stands Optuna's TPE from the same starts at the
same number of simulated realizations, on the same loss and on the score itself. Every setting is
scored on the same scenes, which none of them saw.
"""

import functools
import time
from collections.abc import Callable
from typing import Any, NamedTuple

import jax.numpy as jnp
import numpy as np
import optax
import xarray as xr

from jaxtrack.numerics import positive
from jaxtrack.studies import parts, store, tpe, tune_nht_report
from jaxtrack.studies.nht import WIDE
from jaxtrack.studies.registry import Context, Study
from jaxtrack.studies.tables import SMOKE_BELOW, entry, marks_table
from jaxtrack.studies.tune_nht_trial import (
    MATCH_M,
    ORIGINS,
    Score,
    loss_from,
    missed_from,
    paper,
    score_of,
)
from jaxtrack.tuning import FitResult, fit, mean_loss
from jaxtrack.types import Key

STARTS = {"the paper's": 1.0, "a tenth": 0.1, "ten times": 10.0}
GRADIENT, TPE, TPE_SCORE = "gradient", "TPE", "TPE on top 3"
BEYOND = (0.1, 100.0)  # of the paper's values: what TPE may try, and what the map shows
_NAMES = ("eps_rho_m", "eps_theta_rad")
_LEARNING_RATE = 0.2
_FITS, _SCORES, _MAPS = range(3)  # streams of random keys


class Effort(NamedTuple):
    """How much a tuning may simulate."""

    steps: int
    batch: int
    holdout: int
    every: int
    grid: int  # points of the map, a side
    scenes: int  # of the map


FULL = Effort(steps=80, batch=24, holdout=64, every=10, grid=13, scenes=48)
SMOKE = Effort(steps=4, batch=4, holdout=8, every=2, grid=5, scenes=4)


class Way(NamedTuple):
    """How one method went from one start, evaluation by evaluation."""

    realizations: np.ndarray  # [E] simulated so far
    eps: np.ndarray  # [E, 2] the best so far, by the held-out realizations
    seconds: float  # compilation included; NaN of a run that was interrupted
    steps: np.ndarray  # [S, 2] everything tried


Ways = dict[tuple[str, str, str], Way]
"""By origin of ρ, method and start."""


def run(context: Context) -> None:
    """Run everything, print the tables, save results and figures."""
    say = context.console.print
    effort = effort_of(context.trials)
    ways, fits = tune_all(context, effort)
    if not tpe.is_installed():
        say("Optuna is not installed (extra `peers`): its columns are left out.")
    scores = score_all(context, ways)
    maps = maps_of(context, effort)
    for origin in ORIGINS:
        say(tune_nht_report.table(scores, origin))
    rows = tune_nht_report.marks(scores)
    say(marks_table("Marks, fixed beforehand", rows))
    summary = {
        "study": STUDY.name,
        "source": STUDY.source,
        "seed": context.seed,
        "trials": context.trials,
        "effort": effort._asdict(),
        "marks": [entry(row) for row in rows],
    }
    store.save(context.out, {"scores": scores, "maps": maps}, summary)
    report = functools.partial(context.progress, "figures")
    tune_nht_report.draw(context.out, scores, maps, ways, fits, report)
    parts.forget_parts(context)


def effort_of(trials: int) -> Effort:
    """Return the stated effort, or that of a run which only shows that everything works.

    Example:
        >>> effort_of(500).steps, effort_of(2).steps
        (80, 4)
    """
    return FULL if trials >= SMOKE_BELOW else SMOKE


def tune_all(context: Context, effort: Effort) -> tuple[Ways, dict[tuple[str, str], FitResult]]:
    """Return every tuning's way, and the fits of those by gradient."""
    ways, fits = {}, {}
    searches = {TPE: loss_from, TPE_SCORE: missed_from} if tpe.is_installed() else {}
    for place, origin in enumerate(ORIGINS):
        for number, (start, factor) in enumerate(STARTS.items()):
            key = context.key(_FITS, place, number)
            first = {name: factor * value for name, value in paper().items()}
            way, fits[origin, start] = _descend(context, effort, origin, start, key, first)
            ways[origin, GRADIENT, start] = way
            for method, losses in searches.items():
                what = f"{method}, {origin}, {start}"
                ways[origin, method, start] = _search(
                    context, effort, what, losses(origin), key, first
                )
    return ways, fits


def _descend(
    context: Context, effort: Effort, origin: str, start: str, key: Key, first: dict[str, float]
) -> tuple[Way, FitResult]:
    what = f"gradient, {origin}, {start}"
    folder = parts.folder_of(context, what)
    again = folder.exists()

    def tuned() -> FitResult:
        return fit(
            loss_from(origin),
            first,
            optax.adam(optax.cosine_decay_schedule(_LEARNING_RATE, effort.steps)),
            key=key,
            steps=effort.steps,
            batch=effort.batch,
            holdout=effort.holdout,
            bijectors=positive(),
            every=effort.every,
            micro_batch=1,
            checkpoint=folder,
            progress=functools.partial(context.progress, what),
        )

    def timed() -> float:
        began = time.perf_counter()
        tuned()
        return np.nan if again else time.perf_counter() - began

    seconds = parts.keep_part(context, f"{what}, seconds", timed, 0.0, key, effort.steps, first)
    result = tuned()  # what stands in the folder
    history = result.history
    best = [int(np.argmin(history.held_out[: n + 1])) for n in range(len(history.held_out))]
    steps = np.stack([history.params[name] for name in _NAMES], axis=-1)
    at = history.evaluated[best]
    return Way(history.realizations, steps[at], float(seconds), steps), result


def _search(
    context: Context,
    effort: Effort,
    what: str,
    loss: Callable[..., Any],
    key: Key,
    first: dict[str, float],
) -> Way:
    bounds = {name: (BEYOND[0] * v, BEYOND[1] * v) for name, v in paper().items()}
    report = functools.partial(context.progress, what)
    sizes = effort._asdict()
    budget = {name: sizes[name] for name in ("steps", "batch", "holdout", "every")}

    def searched() -> tuple[tpe.Search, float]:
        began = time.perf_counter()
        found = tpe.search(loss, first, bounds, key=key, progress=report, **budget)
        return found, time.perf_counter() - began

    like = tpe.Search(dict.fromkeys(_NAMES, 0), *(0, 0, 0)), 0.0  # pyright: ignore
    found, seconds = parts.keep_part(context, what, searched, like, key, effort.steps, budget)
    steps = np.stack([found.tried[name] for name in _NAMES], axis=-1)
    best = [int(np.argmin(found.held_out[: n + 1])) for n in range(len(found.held_out))]
    evaluations = np.arange(len(best))
    done = np.minimum(evaluations * effort.every, effort.steps)
    realizations = done * effort.batch + (evaluations + 1) * effort.holdout
    return Way(realizations, steps[found.best[best]], float(seconds), steps)


def score_all(context: Context, ways: Ways) -> xr.Dataset:
    """Return top 3 of every setting on the same held-out scenes, [origin, trial, setting, match].

    Settings are the paper's ε, study `nht`'s wide one, and each way's last; `top_3_on_the_way`
    holds the shares of trials at each evaluation, [origin, tuner, start, evaluation].
    """
    methods = list(dict.fromkeys(method for _, method, _ in ways))
    every = len(next(iter(ways.values())).eps)
    hand = {"paper": tuple(paper().values()), "wide": WIDE}
    shape = len(methods), len(STARTS), every
    tuned = [f"{method}, {start}" for method in methods for start in STARTS]
    table: dict[str, list[np.ndarray]] = {name: [] for name in ("top", "eps", "way", "way_eps")}
    overflow, seconds, realizations = [], [], []
    for place, origin in enumerate(ORIGINS):
        here = [ways[origin, method, start] for method in methods for start in STARTS]
        eps = np.concatenate([np.array(list(hand.values())), *(way.eps for way in here)])
        params = (
            jnp.asarray(ORIGINS[origin]),
            {name: jnp.asarray(eps[:, n]) for n, name in enumerate(_NAMES)},
        )
        what = f"scores, {origin}"
        report = functools.partial(context.progress, what)
        key = context.key(_SCORES, place)
        score: Score = parts.run_part(
            context, what, score_of(), key, context.trials, params, report
        )
        top = np.asarray(score.top_3)
        last = [0, 1, *(len(hand) + every * (n + 1) - 1 for n in range(len(here)))]
        table["top"].append(top[:, last])
        table["eps"].append(eps[last])
        table["way"].append(top[:, len(hand) :, 0].mean(0).reshape(shape))
        table["way_eps"].append(eps[len(hand) :].reshape(*shape, 2))
        overflow.append(np.asarray(score.overflow))
        seconds.append([way.seconds for way in here])
        realizations.append(here[0].realizations)
    way_dims = ("origin", "tuner", "start", "evaluation")
    spent = np.array(seconds).reshape(len(ORIGINS), len(methods), len(STARTS))
    return xr.Dataset(
        {
            "top_3": (("origin", "trial", "setting", "match"), np.stack(table["top"])),
            "eps": (("origin", "setting", "parameter"), np.stack(table["eps"])),
            "overflow": (("origin", "trial"), np.stack(overflow)),
            "seconds": (way_dims[:3], spent, {"units": "s"}),
            "top_3_on_the_way": (way_dims, np.stack(table["way"])),
            "eps_on_the_way": ((*way_dims, "parameter"), np.stack(table["way_eps"])),
            "realizations": ("evaluation", realizations[0]),
        },
        coords={
            "origin": list(ORIGINS),
            "setting": [*hand, *tuned],
            "match": ("match", list(MATCH_M), {"units": "m"}),
            "tuner": methods,
            "start": list(STARTS),
            "parameter": list(_NAMES),
        },
    )


def maps_of(context: Context, effort: Effort) -> xr.Dataset:
    """Return the mean loss over both tolerances, on the same scenes everywhere."""
    low, high = BEYOND
    axes = [np.geomspace(low * v, high * v, effort.grid) for v in paper().values()]
    mesh = np.stack([x.ravel() for x in np.meshgrid(*axes, indexing="ij")], axis=-1)
    settings = {name: jnp.asarray(mesh[:, n]) for n, name in enumerate(_NAMES)}
    maps = []
    for place, origin in enumerate(ORIGINS):
        key = context.key(_MAPS, place)
        report = functools.partial(context.progress, f"map, {origin}")

        def compute(origin: str = origin, key: Key = key, report: Any = report) -> np.ndarray:
            report(0, 1)
            found = mean_loss(
                loss_from(origin),
                settings,
                key=key,
                realizations=effort.scenes,
                micro_batch=1,
                batch_params=True,
            )
            report(1, 1)
            return np.asarray(found.mean)

        name = f"map, {origin}"
        maps.append(parts.keep_part(context, name, compute, 0.0, key, effort.scenes, settings))
    shape = (len(ORIGINS), effort.grid, effort.grid)
    return xr.Dataset(
        {"loss": (("origin", *_NAMES), np.stack(maps).reshape(shape))},
        coords={"origin": list(ORIGINS), **dict(zip(_NAMES, axes, strict=True))},
        attrs={"scenes": effort.scenes},
    )


STUDY = Study(
    name="tune_nht",
    title="Tuning by gradient: the tolerances of the neutrosophic Hough transform",
    source="this library; the transform is that of Fan et al., Neutrosophic Hough Transform-Based "
    "Track Initiation Method for Multiple Target Tracking, IEEE Access, 2018",
    trials_short=2,
    trials_full=500,
    seconds_short=60.0,
    seconds_full=600.0,
    run=run,
)
