"""Tables, marks and figures of the study `learn_weights`."""

import pathlib
from collections.abc import Callable, Mapping
from typing import Any, NamedTuple

import numpy as np
import xarray as xr
from rich.table import Table

from jaxtrack.studies.tables import (
    Figure,
    Mark,
    Row,
    grid_table,
    mean_of,
    number,
    quotient,
    standard_error,
)

CLOSED = Mark(0.60)  # share of the gap between the best threshold and the ceiling
_NAMES = {
    "no weights": "no weights",
    "threshold": "best fixed threshold",
    "labels": "network, on labels alone",
    "tracks": "network, then through the joint vote",
    "ceiling": "true likelihood ratio",
}


class Chosen(NamedTuple):
    """A method at the settings that were best on the scenes for choosing."""

    ospa_m: np.ndarray  # [networks, trials] held out
    values: list[float]  # threshold or k
    gates: list[float]


def choices(scores: xr.Dataset) -> dict[str, list[tuple[int, int]]]:
    """Return every method's best setting and gate, their places; of a network's, each repeat's."""
    found = {}
    for name in _NAMES:
        own = scores.method.values == ("threshold" if name == "no weights" else name)
        if name == "no weights":
            own &= scores.value.values == 0.0
        found[name] = []
        for repeat in sorted(set(scores.network.values[own])):
            here = np.flatnonzero(own & (scores.network.values == repeat))
            before = scores.ospa_choosing.values[:, here].mean(0)
            setting, gate = np.unravel_index(before.argmin(), before.shape)
            found[name].append((int(here[setting]), int(gate)))
    return found


def chosen(scores: xr.Dataset) -> dict[str, Chosen]:
    """Return every method at its best threshold or k, and gate, on the held-out scenes."""
    return {
        name: Chosen(
            np.stack([scores.ospa.values[:, setting, gate] for setting, gate in places]),
            [float(scores.value.values[setting]) for setting, _ in places],
            [float(scores.gate.values[gate]) for _, gate in places],
        )
        for name, places in choices(scores).items()
    }


def table(scores: xr.Dataset) -> Table:
    """Return every method's held-out OSPA, the share of the gap, and what was chosen."""
    best = chosen(scores)
    mean = {name: found.ospa_m.mean(0) for name, found in best.items()}
    lines = []
    for name, found in best.items():
        share = _closed(mean, name)
        each = ", ".join(number(float(x)) for x in found.ospa_m.mean(1))
        what = lambda numbers: ", ".join(f"{x:g}" for x in numbers)
        lines.append(
            [
                f"{number(float(mean[name].mean()))} ± {number(standard_error(mean[name]))} m",
                each if len(found.ospa_m) > 1 else "",
                "" if name == "no weights" else number(share.value),
                what(found.values) if name != "no weights" else "",
                what(found.gates),
            ]
        )
    columns = ["OSPA", "each network", "share of the gap", "threshold or k", "gate"]
    title = "Two targets before a sonar that always reports, held-out scenes"
    return grid_table(title, list(_NAMES.values()), columns, lines, trials=scores.sizes["trial"])


def marks(scores: xr.Dataset) -> list[Row]:
    """Return what has a mark, and what is to be said with standard errors."""
    mean = {name: found.ospa_m.mean(0) for name, found in chosen(scores).items()}
    gap = mean_of(mean["threshold"] - mean["ceiling"], "m")
    gain = mean_of(mean["labels"] - mean["tracks"], "m")
    return [
        Row("OSPA of the best threshold above the ceiling's", gap),
        Row("share closed, trained through the joint vote", _closed(mean, "tracks"), mark=CLOSED),
        Row("share closed, trained on labels alone", _closed(mean, "labels")),
        Row("OSPA on labels alone above that through the joint vote", gain),
    ]


def _closed(mean: Mapping[str, np.ndarray], name: str) -> Figure:
    return quotient(mean["threshold"] - mean[name], mean["threshold"] - mean["ceiling"])


def sensitivity_table(found: xr.Dataset) -> Table:
    """Return d OSPA / d specification by both ways, a tenth of the specification at a time."""
    lines = []
    tenth = 0.1 * found.specification
    for name in map(str, found.name.values):
        here, step = found.sel(name=name), float(tenth.sel(name=name))
        both = [
            f"{number(step * float(here[f'{way}']))} ± {number(step * float(here[f'{way}_error']))}"
            for way in ("slope", "difference")
        ]
        lines.append([f"{float(here.specification):.3g} {here.unit.item()}".strip(), *both])
    columns = ["specification", "score function", "central difference"]
    few = found.attrs["scenes_of_differences"]
    title = f"OSPA of {float(found.ospa):.2f} m, a tenth of each more; differences on {few}"
    return grid_table(
        title, list(map(str, found.name.values)), columns, lines, trials=found.attrs["scenes"]
    )


def draw(
    out: pathlib.Path,
    scores: xr.Dataset,
    sensitivity: xr.Dataset,
    fits: Mapping[tuple[str, int], Any],
    progress: Callable[[int, int], None],
) -> None:
    """Draw methods beside each other, a training, and the sensitivities, into `out`."""
    from jaxtrack import plots

    total = 3
    mean = {_NAMES[name]: found.ospa_m.mean(0) for name, found in chosen(scores).items()}
    figure = plots.means(
        {"": {name: (float(x.mean()), standard_error(x)) for name, x in mean.items()}},
        label="OSPA at the last look, m",
        title="A sonar that always reports, held-out scenes",
    )
    plots.save(figure, out / "ospa_by_method.png")
    progress(1, total)
    # Arrays of a network say nothing one by one: the gate alone is drawn.
    result = fits["tracks", 0]
    history = result.history._replace(params={"gate, nats": result.history.params["gate"]})
    figure = plots.fit_history(
        result._replace(history=history), title="A network trained through the joint vote"
    )
    plots.save(figure, out / "training.png")
    progress(2, total)
    tenth = 0.1 * sensitivity.specification.values
    ways = {"score function": "slope", "central difference, common draws": "difference"}
    names = [
        f"{name}, {value:.3g} {unit}".strip()
        for name, value, unit in zip(
            sensitivity.name.values,
            sensitivity.specification.values,
            sensitivity.unit.values,
            strict=True,
        )
    ]
    figure = plots.means(
        {
            way: {
                name: (float(x), float(error))
                for name, x, error in zip(
                    names,
                    tenth * sensitivity[field].values,
                    tenth * sensitivity[f"{field}_error"].values,
                    strict=True,
                )
            }
            for way, field in ways.items()
        },
        label="OSPA, metres a tenth of the specification",
        title="Which specification of the sonar matters",
    )
    plots.save(figure, out / "sensitivity.png")
    progress(3, total)
