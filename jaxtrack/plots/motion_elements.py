"""One coordinate over time, and the plane of velocities and initial positions it votes in."""

from collections.abc import Mapping
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from jaxtrack.plots.style import COLOURS, FAINT, INK, MARKERS, WIDTH_IN, dress, say_empty, style
from jaxtrack.types import Scan, Truth


def coordinate_over_time(
    scans: Scan,
    truth: Truth,
    lines: Mapping[str, Any],
    *,
    coordinate: int = 0,
    name: str = "north",
    title: str = "",
) -> Figure:
    """Return one coordinate of all detections over time, the truth, and estimated lines.

    Args:
        scans: K looks stacked, in the earth frame.
        truth: at the same looks.
        lines: [M, 2] initial positions (metres, at the first look) and velocities of each method.
        coordinate: 0 for x (north), 1 for y (east).
        name: what the coordinate is called.
        title: of the figure.

    Example:
        >>> scan = Scan(np.zeros(1), np.ones(1, bool), np.zeros((1, 1, 2)), np.ones((1, 1), bool))
        >>> truth = Truth(np.zeros(1), np.zeros((1, 1, 4)), np.ones((1, 1), bool))
        >>> figure = coordinate_over_time(scan, truth, {"CSHT": [[0.0, 1.0]]})
        >>> figure.axes[0].get_ylabel()
        'north, m'

    Source: clustering-statistic Hough transform (2018), figures 8, 10 and 12 to 15.
    """
    mask = np.asarray(scans.mask) & np.asarray(scans.valid)[:, None]
    time_s = np.broadcast_to(np.asarray(scans.time_s)[:, None], mask.shape)[mask]
    position_m = np.asarray(scans.position_m)[..., coordinate][mask]
    looks_s = np.asarray(truth.time_s)
    with style():
        figure = Figure(figsize=(WIDTH_IN, 3.9), layout="constrained")
        axes = figure.add_subplot()
        axes.plot(time_s, position_m, ".", color="#999999", ms=4, label="detections")
        there, path_m = np.asarray(truth.mask), np.asarray(truth.state)[..., coordinate]
        for target in range(there.shape[1]):
            axes.plot(
                looks_s[there[:, target]],
                path_m[there[:, target], target],
                color=INK,
                ls=(0, (4, 2)),
                lw=1.2,
                label="truth" if target == 0 else None,
            )
        ends_s = np.array([looks_s[0], looks_s[-1]])
        for place, (method, table) in enumerate(lines.items()):
            for row, (start_m, velocity) in enumerate(np.asarray(table).reshape(-1, 2)):
                axes.plot(
                    ends_s,
                    start_m + velocity * (ends_s - ends_s[0]),
                    color=COLOURS[place % len(COLOURS)],
                    lw=1.4,
                    alpha=0.85,
                    label=method if row == 0 else None,
                )
        axes.set(xlabel="time, s", ylabel=f"{name}, m")
        axes.set_title(title, loc="left", fontweight="bold")
        dress(axes)
        handles, labels = axes.get_legend_handles_labels()
        figure.legend(handles, labels, loc="outside lower center", ncols=len(handles))
        if not mask.any():
            say_empty(axes, "no detections")
    return figure


def vote_plane(
    votes: Any,
    velocity_m_s: Any,
    position_m: Any,
    *,
    truth: Any = (),
    centres: Any = (),
    samples: Any = (),
    title: str = "",
) -> Figure:
    """Return a vote matrix from above, with true lines, clustered cells and clusters' centres.

    Initial positions are shown as far as there are votes, or anything that is marked.

    Args:
        votes: [V, P].
        velocity_m_s: [V] of its rows.
        position_m: [P] of its columns, initial positions.
        truth: [K, 2] true velocities and initial positions.
        centres: [M, 2] of clusters, likewise.
        samples: [C, 2] cells that were clustered, likewise.
        title: of the figure.

    Example:
        >>> figure = vote_plane(np.eye(3), [-1.0, 0.0, 1.0], [0.0, 4.0, 8.0], truth=[[0.0, 4.0]])
        >>> figure.axes[0].get_xlabel()
        'velocity, m/s'

    Source: clustering-statistic Hough transform (2018), figures 9 and 11.
    """
    with style():
        figure = Figure(figsize=(WIDTH_IN, 4.2), layout="constrained")
        axes = figure.add_subplot()
        marked = (
            (samples, {"marker": ".", "color": COLOURS[5], "ms": 4}, "clustered cells"),
            (centres, {"marker": "s", "color": COLOURS[1], "mfc": "none", "ms": 9}, "clusters"),
            (truth, {"marker": "+", "color": COLOURS[0], "ms": 12, "mew": 1.8}, "truth"),
        )
        _plane(figure, axes, votes, velocity_m_s, position_m, marked)
        axes.set_title(title, loc="left", fontweight="bold")
        handles, labels = axes.get_legend_handles_labels()
        if handles:
            figure.legend(handles, labels, loc="outside lower center", ncols=len(handles))
    return figure


def points_and_votes(
    scans: Scan,
    line: Any,
    votes: Any,
    velocity_m_s: Any,
    position_m: Any,
    *,
    coordinate: int = 0,
    name: str = "north",
    title: str = "",
) -> Figure:
    """Return one coordinate of the detections over time, and beside it the votes that they give.

    Args:
        scans: K looks stacked, in the earth frame.
        line: [2] velocity and initial position of the one target.
        votes: [V, P].
        velocity_m_s: [V] of its rows.
        position_m: [P] of its columns, initial positions.
        coordinate: 0 for x (north), 1 for y (east).
        name: what the coordinate is called.
        title: of the figure.

    Example:
        >>> scan = Scan(np.zeros(1), np.ones(1, bool), np.zeros((1, 1, 2)), np.ones((1, 1), bool))
        >>> figure = points_and_votes(scan, [1.0, 0.0], np.eye(2), [0.0, 1.0], [0.0, 4.0])
        >>> [axes.get_xlabel() for axes in figure.axes[:2]]
        ['time, s', 'velocity, m/s']

    Source: clustering-statistic Hough transform (2018), figures 4 and 5.
    """
    mask = np.asarray(scans.mask) & np.asarray(scans.valid)[:, None]
    looks_s = np.asarray(scans.time_s)
    time_s = np.broadcast_to(looks_s[:, None], mask.shape)[mask]
    velocity, start_m = np.asarray(line, np.float64)
    with style():
        figure = Figure(figsize=(WIDTH_IN, 3.4), layout="constrained")
        left, right = figure.subplots(1, 2)
        seen_m = np.asarray(scans.position_m)[..., coordinate][mask]
        left.plot(time_s, seen_m, ".", color="#999999", ms=4, label="detections")
        ends_s = looks_s[[0, -1]]
        path_m = start_m + velocity * (ends_s - ends_s[0])
        left.plot(ends_s, path_m, color=INK, ls=(0, (4, 2)), lw=1.2, label="true line")
        left.set(xlabel="time, s", ylabel=f"{name}, m")
        dress(left)
        look = {"marker": "+", "color": COLOURS[0], "ms": 12, "mew": 1.8}
        marked = (([[velocity, start_m]], look, "true velocity and initial position"),)
        _plane(figure, right, votes, velocity_m_s, position_m, marked)
        figure.suptitle(title, x=0.01, ha="left", fontsize=10, fontweight="bold")
        found = [axes.get_legend_handles_labels() for axes in (left, right)]
        handles, labels = ([*a, *b] for a, b in zip(*found, strict=True))
        figure.legend(handles, labels, loc="outside lower center", ncols=len(handles))
    return figure


def _plane(
    figure: Figure, axes: Axes, votes: Any, velocity_m_s: Any, position_m: Any, marked: Any
) -> None:
    """Draw votes from above, and tables of points (velocity, initial position) over them."""
    votes = np.asarray(votes, np.float64)
    rows, columns = np.asarray(velocity_m_s), np.asarray(position_m)
    mesh = axes.pcolormesh(rows, columns, votes.T, cmap="Greys", shading="nearest")
    bar = figure.colorbar(mesh, ax=axes, shrink=0.8, aspect=30, pad=0.02)
    bar.set_label("votes")
    bar.outline.set_visible(False)  # type: ignore[operator]
    shown = [columns[(votes > 0).any(axis=0)]]
    for table, look, label in marked:
        table = np.asarray(table, np.float64).reshape(-1, 2)
        if len(table):
            axes.plot(*table.T, ls="none", label=label, **look)
            shown.append(table[:, 1])
    heights = np.concatenate(shown)
    if len(heights):
        step = np.diff(columns).mean() if len(columns) > 1 else 1.0
        axes.set_ylim(heights.min() - step, heights.max() + step)
    axes.set(xlabel="velocity, m/s", ylabel="initial position, m")
    dress(axes)
    axes.grid(False)


def error_curves(
    panels: Mapping[str, Mapping[str, tuple[Any, Any, Any]]],
    *,
    x_label: str,
    y_label: str,
    paper: Mapping[str, Mapping[str, tuple[Any, Any]]] | None = None,
    title: str = "",
) -> Figure:
    """Return errors against a condition, a panel a value of another, on a logarithmic scale.

    Bars are two standard errors to each side, and the axis says so.

    Args:
        panels: by panel, by method: conditions [N], mean errors [N] and standard errors [N].
        x_label: the condition and its unit.
        y_label: the error and its unit.
        paper: by panel, by method: conditions and the paper's figures, drawn hollow.
        title: of the figure.

    Example:
        >>> curve = ([0.1, 0.3], [1.0, 1.2], [0.1, 0.1])
        >>> figure = error_curves({"": {"joint": curve}}, x_label="P_F", y_label="OSPA, m")
        >>> figure.axes[0].get_yscale()
        'log'

    Source: clustering-statistic Hough transform (2018), figures 16 to 19.
    """
    methods = list(dict.fromkeys(name for panel in panels.values() for name in panel))
    looks = {name: (COLOURS[k % 7], MARKERS[k % 7]) for k, name in enumerate(methods)}
    printed = dict.fromkeys(name for panel in (paper or {}).values() for name in panel)
    # What the paper alone has is told apart by its marker.
    looks |= {
        n: (INK, MARKERS[-1 - k % 7]) for k, n in enumerate(n for n in printed if n not in looks)
    }
    with style():
        columns = min(max(len(panels), 1), 4)
        figure = Figure(figsize=(WIDTH_IN, 3.6), layout="constrained")
        grid: Any = np.ravel(figure.subplots(1, columns, sharey=True, squeeze=False))
        for axes, (name, panel) in zip(grid, panels.items(), strict=True):
            for method, (x, mean, error) in panel.items():
                colour, marker = looks[method]
                axes.errorbar(x, mean, yerr=2 * np.asarray(error), color=colour, marker=marker,
                              ms=4.5, lw=1.2, capsize=2, label=method)  # fmt: skip
            for method, (x, mean) in (paper or {}).get(name, {}).items():
                colour, marker = looks[method]
                axes.plot(x, mean, color=colour, marker=marker, mfc="white", ms=4.5, lw=0.9,
                          ls=(0, (2, 2)), label=f"{method}, paper")  # fmt: skip
            axes.set_yscale("log")
            axes.set_xlabel(x_label)
            axes.set_title(name, loc="left")
            axes.grid(True, which="minor", axis="y", color=FAINT, linewidth=0.3)
            dress(axes)
        grid[0].set_ylabel(f"{y_label}\nmean ± 2 standard errors")
        figure.suptitle(title, x=0.01, ha="left", fontsize=10, fontweight="bold")
        handles, labels = grid[0].get_legend_handles_labels()
        if handles:
            figure.legend(handles, labels, loc="outside lower center", ncols=min(len(handles), 5))
    return figure
