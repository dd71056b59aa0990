"""What the studies of tuning share: settings found by gradient and by Optuna's TPE, and scored.

From each start a tuning goes down the gradient of a smooth loss; beside it stands Optuna's TPE from
the same start at the same number of simulated realizations, on the same loss and on the score
itself. Every setting on every way is scored on the same scenes, which none of them saw.

Three programs are compiled for a case: the loss, its gradient, the score.
"""

import functools
import time
from collections.abc import Callable, Collection, Iterable, Mapping
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
import optax

from jaxtrack.montecarlo import MonteCarlo
from jaxtrack.numerics import bounded, positive
from jaxtrack.studies import parts
from jaxtrack.studies.registry import Context
from jaxtrack.studies.tuned import tpe
from jaxtrack.tuning import FitResult, fit, mean_loss, sinkhorn_ospa
from jaxtrack.types import Array, Key, Tracks

GRADIENT, TPE, TPE_SCORE = "gradient", "TPE", "TPE on the score"
_LEARNING_RATE = 0.2
_FITS = 0  # stream of random keys

STARTS = {"a fifth": 0.2, "five times": 5.0}
"""From where what was set by hand is tuned anew, where a study has no starts of its own."""

_MOST = 0.95  # of a share
_TEMPERATURE, _ITERATIONS = 0.02, 30  # of the smooth OSPA

Settings = Mapping[str, Any]
"""What is tuned: a number by name."""


class Score(NamedTuple):
    """What counts in one scene, less being better."""

    value: Array  # [measure]
    overflow: Array  # [] some table was too small


def smooth_ospa(
    tracks: Tracks, existence: Array, state: Array, there: Array, *, cutoff: float, order: float
) -> Array:
    """Return the smooth OSPA of tracks that exist in part, by their positions, metres.

    Args:
        tracks: [M].
        existence: [M].
        state: [N, 4] of the targets.
        there: [N].
        cutoff: metres.
        order: p ≥ 1.
    """
    return sinkhorn_ospa(
        tracks.mean[:, :2],
        tracks.mask,
        state[:, :2],
        there,
        cutoff=cutoff,
        order=order,
        temperature=_TEMPERATURE,
        iterations=_ITERATIONS,
        existence=existence,
    ).distance


class Case(NamedTuple):
    """One thing to tune."""

    loss: Callable[[Settings, Key], Array]  # smooth; the same object every time, as the score
    score: Callable[[Settings, Key], Score]
    hand: Mapping[str, Settings]  # settings to compare with, the default first
    starts: Mapping[str, Settings]
    bounds: Mapping[str, tuple[float, float]]  # what TPE may try; and the map shows
    bijectors: Any  # of the settings, as `fit` takes them
    axes: tuple[str, str]  # of the map
    clip: float | None = None  # of the mean gradient's norm


def case_around(
    name: str,
    default: Settings,
    loss: Callable[[Settings, Key], Array],
    score: Callable[[Settings, Key], Score],
    axes: tuple[str, str],
    *,
    shares: Collection[str] = (),
    clip: float | None = None,
) -> Case:
    """Return what is tuned anew from a fifth and from five times of what was set by hand.

    TPE may try a tenth to ten times of it. Shares stop at .95.

    Args:
        name: of what was set by hand.
        default: it.
        loss: smooth.
        score: what counts.
        axes: of the map.
        shares: which settings are below 1; all are positive.
        clip: of the mean gradient's norm.
    """
    times = lambda factor: {
        n: min(factor * x, _MOST) if n in shares else factor * x for n, x in default.items()
    }
    low, high = times(0.1), times(10.0)
    return Case(
        loss=loss,
        score=score,
        hand={name: default},
        starts={start: times(factor) for start, factor in STARTS.items()},
        bounds={n: (low[n], high[n]) for n in default},
        bijectors={n: bounded(0.0, 1.0) if n in shares else positive() for n in default},
        axes=axes,
        clip=clip,
    )


class Effort(NamedTuple):
    """How much a tuning may simulate."""

    steps: int
    batch: int
    holdout: int
    every: int
    grid: int  # points of the map, a side
    scenes: int  # of the map


class Way(NamedTuple):
    """How one method went from one start, evaluation by evaluation."""

    realizations: np.ndarray  # [E] simulated so far
    best: np.ndarray  # [E, P] the best so far, by the held-out realizations
    seconds: float  # compilation included; NaN of a fit that an interrupted run had begun
    steps: np.ndarray  # [S, P] everything tried


Ways = dict[tuple[str, str, str], Way]
"""By case, method and start."""


def tune_all(
    context: Context, effort: Effort, cases: Mapping[str, Case]
) -> tuple[Ways, dict[tuple[str, str], FitResult]]:
    """Return every tuning's way, and the fits of those by gradient, by case and start."""
    ways, fits = {}, {}
    for place, (name, case) in enumerate(cases.items()):
        searches = {
            TPE: lambda *at, case=case: run_mean(case.loss, *at).mean,
            TPE_SCORE: lambda *at, case=case: run_mean(case.score, *at).mean.value[0],
        }
        for number, start in enumerate(case.starts):
            key = context.key(_FITS, place, number)
            ways[name, GRADIENT, start], fits[name, start] = _descend(
                context, effort, case, f"{GRADIENT}, {name}, {start}", key, case.starts[start]
            )
            for method, mean in searches.items() if tpe.is_installed() else ():
                what = f"{method}, {name}, {start}"
                ways[name, method, start] = _search(
                    context, effort, case, what, mean, key, case.starts[start]
                )
    return ways, fits


def _descend(
    context: Context, effort: Effort, case: Case, what: str, key: Key, start: Settings
) -> tuple[Way, FitResult]:
    folder = parts.folder_of(context, what)
    again, began = folder.exists(), time.perf_counter()
    result = fit(
        case.loss,
        start,
        optax.adam(optax.cosine_decay_schedule(_LEARNING_RATE, effort.steps)),
        key=key,
        steps=effort.steps,
        batch=effort.batch,
        holdout=effort.holdout,
        bijectors=case.bijectors,
        clip=case.clip,
        every=effort.every,
        micro_batch=1,
        checkpoint=folder,
        progress=functools.partial(context.progress, what),
    )
    seconds = np.nan if again else time.perf_counter() - began
    history = result.history
    best = _so_far(history.held_out)
    steps = np.stack([history.params[name] for name in case.bounds], axis=-1)
    at = history.evaluated[best]
    return Way(history.realizations, steps[at], seconds, steps), result


def _search(
    context: Context,
    effort: Effort,
    case: Case,
    what: str,
    mean: Callable[..., Any],
    key: Key,
    start: Settings,
) -> Way:
    report = functools.partial(context.progress, what)
    sizes = effort._asdict()
    budget = {name: sizes[name] for name in ("steps", "batch", "holdout", "every")}

    def searched() -> tuple[tpe.Search, float]:
        began = time.perf_counter()
        found = tpe.search(mean, start, case.bounds, key=key, progress=report, **budget)
        return found, time.perf_counter() - began

    like = tpe.Search(dict.fromkeys(case.bounds, 0), *(0, 0, 0)), 0.0  # pyright: ignore
    found, seconds = parts.keep_part(context, what, searched, like, key, effort.steps, budget)
    steps = np.stack([found.tried[name] for name in case.bounds], axis=-1)
    best = _so_far(found.held_out)
    evaluations = np.arange(len(best))
    done = np.minimum(evaluations * effort.every, effort.steps)
    realizations = done * effort.batch + (evaluations + 1) * effort.holdout
    return Way(realizations, steps[found.best[best]], float(seconds), steps)


def _so_far(losses: np.ndarray) -> list[int]:
    """Return which is the least of those up to each."""
    return [int(np.nanargmin(losses[: n + 1])) for n in range(len(losses))]


def label(method: str, start: str) -> str:
    """Return what the setting is called that a method found from a start."""
    return f"{method}, {start}"


def named(names: Iterable[str], values: np.ndarray) -> dict[str, float]:
    """Return numbers by their names."""
    return {name: float(value) for name, value in zip(names, values, strict=True)}


def run_mean(fn: Callable[..., Any], settings: Settings, key: Key, realizations: int) -> MonteCarlo:
    """Return a loss or a score over realizations, by the program that `fit` compiles of a loss.

    One by one: a batch of vote tables would leave the cache.
    """
    number = lambda x: np.asarray(x, jnp.result_type(float))  # else compiled anew
    params = jax.tree.map(number, dict(settings))
    return mean_loss(fn, params, key=key, realizations=realizations, micro_batch=1)
