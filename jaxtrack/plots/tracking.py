"""What trackers make of a scene: positions over time, maps, and errors over time."""

from collections.abc import Mapping
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from jaxtrack.plots.style import COLOURS, INK, MARKERS, WIDTH_IN, dress, style
from jaxtrack.types import Truth

_NAMES = ("north", "east")


def positions_over_time(truth: Truth, tracks: Mapping[str, Any], *, title: str = "") -> Figure:
    """Return north and east of the targets (dashed) and of the tracks, a column a tracker.

    Args:
        truth: T looks at K targets, x north.
        tracks: by tracker: positions [T, M, 2] and which of the slots are reported, [T, M].
        title: of the figure.

    Example:
        >>> truth = Truth(np.arange(2.0), np.ones((2, 1, 4)), np.ones((2, 1), bool))
        >>> found = np.ones((2, 3, 2)), np.ones((2, 3), bool)
        >>> figure = positions_over_time(truth, {"joint": found})
        >>> [axes.get_ylabel() for axes in figure.axes]
        ['north, m', 'east, m']

    Source: clustering-statistic Hough transform (2018), figure 20.
    """
    time_s = np.asarray(truth.time_s)
    with style():
        figure = Figure(figsize=(WIDTH_IN, 4.8), layout="constrained")
        grid = figure.subplots(2, len(tracks), sharex=True, sharey="row", squeeze=False)
        for column, (name, (position_m, mask)) in zip(grid.T, tracks.items(), strict=True):
            for axis, axes in enumerate(column):
                _truth_lines(axes, truth, time_s, axis)
                look, _, values = _reported(position_m, mask, axis)
                axes.plot(time_s[look], values, ".", ms=2.5, color=COLOURS[1], label="tracks")
                dress(axes)
            column[0].set_title(name, loc="left")
            column[-1].set_xlabel("time, s")
        for axes, name in zip(grid[:, 0], _NAMES, strict=True):
            axes.set_ylabel(f"{name}, m")
        _legend(figure, grid[0, 0], title)
    return figure


def maps(truth: Truth, tracks: Mapping[str, Any], *, title: str = "") -> Figure:
    """Return maps of true paths (dashed) and of tracks, a panel a tracker, north upwards.

    Args:
        truth: T looks at K targets, x north.
        tracks: by tracker: positions [T, M, 2] and which of the slots are reported, [T, M].
        title: of the figure.

    Example:
        >>> truth = Truth(np.arange(2.0), np.ones((2, 1, 4)), np.ones((2, 1), bool))
        >>> figure = maps(truth, {"joint": (np.ones((2, 3, 2)), np.ones((2, 3), bool))})
        >>> figure.axes[0].get_xlabel()
        'east, m'

    Source: clustering-statistic Hough transform (2018), figure 21.
    """
    with style():
        figure = Figure(figsize=(WIDTH_IN, 3.0), layout="constrained")
        row = figure.subplots(1, len(tracks), sharex=True, sharey=True, squeeze=False)[0]
        state, there = np.asarray(truth.state), np.asarray(truth.mask)
        for axes, (name, (position_m, mask)) in zip(row, tracks.items(), strict=True):
            look, slot, north = _reported(position_m, mask, 0)
            east = np.asarray(position_m)[look, slot, 1]
            colour = np.array(COLOURS[:6])[slot % 6]
            axes.scatter(east, north, s=2, c=colour, linewidths=0, label="tracks, by slot")
            for target in range(there.shape[1]):
                path = state[there[:, target], target]
                label = "truth" if target == 0 else None
                axes.plot(path[:, 1], path[:, 0], color=INK, ls=(0, (4, 2)), lw=0.9, label=label)
            axes.set_aspect("equal")
            axes.set_title(name, loc="left")
            axes.set_xlabel("east, m")
            dress(axes)
        row[0].set_ylabel("north, m")
        _legend(figure, row[0], title)
    return figure


def errors_over_time(
    time_s: Any, panels: Mapping[str, Mapping[str, Any]], *, title: str = ""
) -> Figure:
    """Return errors over time, one panel below the other.

    Args:
        time_s: [T].
        panels: by error, by tracker: [T], metres.
        title: of the figure.

    Example:
        >>> figure = errors_over_time([0.0, 1.0], {"OSPA": {"joint": [20.0, 1.0]}})
        >>> figure.axes[0].get_ylabel()
        'OSPA, m'

    Source: clustering-statistic Hough transform (2018), figure 22.
    """
    methods = list(dict.fromkeys(name for panel in panels.values() for name in panel))
    with style():
        figure = Figure(figsize=(WIDTH_IN, 0.8 + 1.6 * len(panels)), layout="constrained")
        column: Any = np.ravel(figure.subplots(len(panels), 1, sharex=True, squeeze=False))
        for axes, (what, curves) in zip(column, panels.items(), strict=True):
            for name, values in curves.items():
                k = methods.index(name) % 7
                axes.plot(time_s, values, color=COLOURS[k], lw=1.2, marker=MARKERS[k], ms=3.5,
                          markevery=max(len(time_s) // 12, 1), label=name)  # fmt: skip
            axes.set_ylim(bottom=0.0)
            axes.set_ylabel(f"{what}, m")
            dress(axes)
        column[-1].set_xlabel("time, s")
        _legend(figure, column[0], title)
    return figure


def _truth_lines(axes: Axes, truth: Truth, time_s: np.ndarray, axis: int) -> None:
    there, state = np.asarray(truth.mask), np.asarray(truth.state)[..., axis]
    for target in range(there.shape[1]):
        seen = there[:, target]
        label = "truth" if target == 0 else None
        axes.plot(time_s[seen], state[seen, target], color=INK, ls=(0, (4, 2)), lw=1, label=label)


def _reported(position_m: Any, mask: Any, axis: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    look, slot = np.nonzero(np.asarray(mask))
    return look, slot, np.asarray(position_m)[look, slot, axis]


def _legend(figure: Figure, axes: Axes, title: str) -> None:
    figure.suptitle(title, x=0.01, ha="left", fontsize=10, fontweight="bold")
    handles, labels = axes.get_legend_handles_labels()
    figure.legend(handles, labels, loc="outside lower center", ncols=min(len(handles), 5))
