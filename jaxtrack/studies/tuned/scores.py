"""What the settings that a tuning found are worth on held-out scenes, and the loss around them."""

from collections.abc import Mapping
from typing import Any

import numpy as np
import xarray as xr

from jaxtrack.studies import parts
from jaxtrack.studies.registry import Context
from jaxtrack.studies.tuned.ways import GRADIENT, Case, Effort, Ways, label, named, run_mean
from jaxtrack.types import Key

_SCORES, _MAPS = 1, 2  # streams of random keys; those of the tunings are 0


def score_all(context: Context, cases: Mapping[str, Case], ways: Ways) -> xr.Dataset:
    """Return every setting's score on the same held-out scenes, [case, trial, setting, measure].

    Settings are those by hand, and each way's last; `score_on_the_way` holds means over the trials
    at each evaluation, [case, tuner, start, evaluation], of the first measure.
    """
    methods = list(dict.fromkeys(method for _, method, _ in ways))
    any_case = next(iter(cases.values()))
    hands, starts, names = (list(x) for x in (any_case.hand, any_case.starts, any_case.bounds))
    every = len(next(iter(ways.values())).best)
    shape = len(methods), len(starts), every
    table: dict[str, list[Any]] = {
        name: [] for name in ("score", "params", "way", "way_params", "overflow", "seconds")
    }
    realizations = np.zeros(every)
    for place, (name, case) in enumerate(cases.items()):
        here = [ways[name, method, start] for method in methods for start in starts]
        hand = np.array([[each[p] for p in names] for each in case.hand.values()])
        tried = np.concatenate([hand, *(way.best for way in here)])
        value, overflow = _score(
            context, case, f"scores, {name}", context.key(_SCORES, place), tried
        )
        last = [*range(len(hands)), *(len(hands) + every * (n + 1) - 1 for n in range(len(here)))]
        table["score"].append(np.swapaxes(value[last], 0, 1))
        table["params"].append(tried[last])
        table["way"].append(value[len(hands) :, :, 0].mean(1).reshape(shape))
        table["way_params"].append(tried[len(hands) :].reshape(*shape, len(names)))
        table["overflow"].append(overflow[last].T)
        table["seconds"].append(np.reshape([way.seconds for way in here], shape[:2]))
        realizations = here[0].realizations
    way_dims = ("case", "tuner", "start", "evaluation")
    stacked = {name: np.stack(values) for name, values in table.items()}
    return xr.Dataset(
        {
            "score": (("case", "trial", "setting", "measure"), stacked["score"]),
            "params": (("case", "setting", "parameter"), stacked["params"]),
            "overflow": (("case", "trial", "setting"), stacked["overflow"]),
            "seconds": (way_dims[:3], stacked["seconds"], {"units": "s"}),
            "score_on_the_way": (way_dims, stacked["way"]),
            "params_on_the_way": ((*way_dims, "parameter"), stacked["way_params"]),
            "realizations": ("evaluation", realizations),
        },
        coords={
            "case": list(cases),
            "setting": [*hands, *(label(method, start) for method in methods for start in starts)],
            "tuner": methods,
            "start": starts,
            "parameter": names,
        },
    )


def _score(
    context: Context, case: Case, what: str, key: Key, tried: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Return scores [setting, trial, measure] and overflows [setting, trial]."""
    distinct, back = np.unique(tried, axis=0, return_inverse=True)

    def compute() -> tuple[np.ndarray, np.ndarray]:
        found = []
        for done, setting in enumerate(distinct):
            context.progress(what, done, len(distinct))
            run = run_mean(case.score, named(case.bounds, setting), key, context.trials)
            found.append(run.values)
        context.progress(what, len(distinct), len(distinct))
        return np.stack([x.value for x in found]), np.stack([x.overflow for x in found])

    value, overflow = parts.keep_part(context, what, compute, (0, 0), key, context.trials, distinct)
    return value[back], overflow[back]


def maps_of(
    context: Context, effort: Effort, cases: Mapping[str, Case], scores: xr.Dataset
) -> dict[str, xr.Dataset]:
    """Return by case the mean loss over two parameters, on the same scenes everywhere.

    The others are what the gradient made of them from the first start.
    """
    maps = {}
    for place, (name, case) in enumerate(cases.items()):
        first = label(GRADIENT, next(iter(case.starts)))
        rest = scores.params.sel(case=name, setting=first).values
        axes = {axis: np.geomspace(*case.bounds[axis], effort.grid) for axis in case.axes}
        what, key = f"map, {name}", context.key(_MAPS, place)

        def compute(
            case: Case = case, rest: Any = rest, axes: Any = axes, what: str = what, key: Key = key
        ) -> np.ndarray:
            mesh = np.stack(np.meshgrid(*axes.values(), indexing="ij"), axis=-1).reshape(-1, 2)
            found = []
            for done, at in enumerate(mesh):
                context.progress(what, done, len(mesh))
                params = {**named(case.bounds, rest), **named(case.axes, at)}
                run = run_mean(case.loss, params, key, effort.scenes)
                found.append(float(run.mean))
            context.progress(what, len(mesh), len(mesh))
            return np.reshape(found, (effort.grid, effort.grid))

        loss = parts.keep_part(context, what, compute, 0.0, key, effort.scenes, (rest, axes))
        maps[what] = xr.Dataset(
            {"loss": (case.axes, loss)}, coords=axes, attrs={"scenes": effort.scenes}
        )
    return maps
