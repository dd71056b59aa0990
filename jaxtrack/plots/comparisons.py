"""Methods beside each other: how long they take, how often they are right, how far they are off."""

from collections.abc import Mapping
from typing import Any

import numpy as np
from matplotlib.figure import Figure
from matplotlib.lines import Line2D

from jaxtrack.plots.style import (
    COLOURS,
    FAINT,
    INK,
    MARKERS,
    WIDTH_IN,
    dress,
    looks_of,
    say_empty,
    style,
)

Share = tuple[float, float, float]
"""A share of runs and the ends of its interval, all in [0, 1]."""


def run_times(
    clutter: Any, seconds: Mapping[str, Any], paper: Mapping[str, float] | None = None
) -> Figure:
    """Return each method's time a run against the clutter, logarithmic.

    Args:
        clutter: [C] false detections a look.
        seconds: [C] time of one run by method.
        paper: the paper's times by method, drawn as ticks in the margin.

    Example:
        >>> figure = run_times([10, 56], {"joint": [4e-3, 2e-2]}, {"joint": 0.06})
        >>> figure.axes[0].get_yscale()
        'log'

    Source: neutrosophic Hough transform (2018), figure 11.
    """
    clutter = np.asarray(clutter, np.float64)
    looks = looks_of(dict.fromkeys([*seconds, *(paper or {})]))
    with style():
        figure = Figure(figsize=(WIDTH_IN, 3.8), layout="constrained")
        axes = figure.add_subplot()
        axes.set_yscale("log")
        axes.set(xlabel="clutter, false detections a look", ylabel="time a run, s")
        for name, values in seconds.items():
            colour, marker = looks[name]
            values = np.asarray(values, np.float64)
            axes.plot(clutter, values, color=colour, marker=marker, ms=5, label=name)
        handles, labels = axes.get_legend_handles_labels()
        for name, value in (paper or {}).items():
            colour, _ = looks[name]
            axes.axhline(value, 0.955, 1.0, color=colour, lw=2.5, solid_capstyle="butt")
        if paper:
            low, high = (clutter.min(), clutter.max()) if len(clutter) else (0.0, 1.0)
            axes.set_xlim(low - 0.05 * (high - low or 1), high + 0.12 * (high - low or 1))
            handles.append(Line2D([], [], color="#777777", lw=2.5))
            labels.append("the paper, on its machine")
        if handles:
            figure.legend(handles, labels, loc="outside right center")
        if not seconds or not len(clutter):
            say_empty(axes, "no run times")
        dress(axes)
    return figure


def scores(
    shares: Mapping[str, Mapping[str, Share]],
    *,
    title: str = "",
    marks: Mapping[str, float] | None = None,
) -> Figure:
    """Return the share of runs by situation and method, with intervals.

    Args:
        shares: (value, low, high) in [0, 1] by method, then by situation.
        title: what the share counts.
        marks: a wanted share by situation, drawn as a line across it.

    Example:
        >>> figure = scores({"joint": {"IV": (0.9, 0.85, 0.94)}}, title="All targets found")
        >>> [label.get_text() for label in figure.axes[0].get_xticklabels()]
        ['IV']
    """
    situations = list(dict.fromkeys(name for share in shares.values() for name in share))
    looks = looks_of(shares)
    step = min(0.8 / max(len(shares), 1), 0.16)
    with style():
        figure = Figure(figsize=(WIDTH_IN, 3.6), layout="constrained")
        axes = figure.add_subplot()
        for place, (method, by_situation) in enumerate(shares.items()):
            colour, marker = looks[method]
            there = [name for name in situations if name in by_situation]
            at = np.array([situations.index(name) for name in there], np.float64)
            table = 100 * np.array([by_situation[name] for name in there]).reshape(-1, 3)
            value, low, high = table.T
            axes.errorbar(
                at + step * (place - (len(shares) - 1) / 2),
                value,
                # The value may lie outside its interval by rounding.
                yerr=np.maximum([value - low, high - value], 0.0),
                color=colour,
                marker=marker,
                linestyle="none",
                ms=6,
                elinewidth=1.4,
                capsize=2.5,
                clip_on=False,
            )
        for place, name in enumerate(situations):
            if place:
                axes.axvline(place - 0.5, color=FAINT, lw=0.8)
            if marks and name in marks:
                ends = [place - 0.45, place + 0.45]
                axes.plot(ends, [100 * marks[name]] * 2, color=INK, lw=1.0, ls=(0, (3, 2)))
        axes.set_xticks(range(len(situations)), situations)
        axes.set(xlim=(-0.5, max(len(situations), 1) - 0.5), ylim=(0, 100))
        axes.set_ylabel("share of runs, %")
        axes.set_title(title, loc="left", fontweight="bold", pad=12)
        handles = [
            Line2D([], [], color=colour, marker=marker, ls="none", ms=6)
            for colour, marker in looks.values()
        ]
        labels = list(looks)
        if marks:
            handles.append(Line2D([], [], color=INK, lw=1.0, ls=(0, (3, 2))))
            labels.append("wanted")
        if handles:
            figure.legend(handles, labels, loc="outside lower center", ncols=min(len(handles), 4))
        if not situations:
            say_empty(axes, "no runs")
        dress(axes, grid="y")
        axes.tick_params(axis="x", length=0)
    return figure


def means(
    groups: Mapping[str, Mapping[str, tuple[float, float]]], *, label: str, title: str = ""
) -> Figure:
    """Return means with two standard errors to each side, a line a name, a colour a group.

    Args:
        groups: mean and standard error by group, then by name.
        label: what is measured, and its unit.
        title: of the figure.

    Example:
        >>> figure = means({"": {"joint": (1.2, 0.1), "standard": (3.0, 0.2)}}, label="OSPA, m")
        >>> [text.get_text() for text in figure.axes[0].get_yticklabels()]
        ['joint', 'standard']
    """
    names = list(dict.fromkeys(name for group in groups.values() for name in group))
    step = 0.7 / max(len(groups), 1)
    with style():
        figure = Figure(figsize=(WIDTH_IN, 1.5 + 0.45 * max(len(names), 2)), layout="constrained")
        axes = figure.add_subplot()
        for place, (group, values) in enumerate(groups.items()):
            at = [names.index(name) + step * (place - (len(groups) - 1) / 2) for name in values]
            mean, error = np.array(list(values.values()), np.float64).reshape(-1, 2).T
            axes.errorbar(
                mean,
                at,
                xerr=2 * np.where(np.isfinite(error), error, 0.0),
                color=COLOURS[place % len(COLOURS)],
                marker=MARKERS[place % len(MARKERS)],
                linestyle="none",
                ms=6,
                elinewidth=1.4,
                capsize=2.5,
                label=group,
            )
        axes.set_yticks(range(len(names)), names)
        axes.set_ylim(max(len(names), 1) - 0.5, -0.5)
        axes.set_xlabel(f"{label}\nmean ± 2 standard errors")
        axes.set_title(title, loc="left", fontweight="bold")
        if len(groups) > 1:
            figure.legend(loc="outside lower center", ncols=len(groups))
        if not names:
            say_empty(axes, "no means")
        dress(axes, grid="x")
    return figure
