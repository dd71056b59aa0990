"""A particle filter that follows one target in point clouds: where it looks, and where it is.

Maps are drawn with east to the right and north upwards, as x is north and y is east.
"""

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.patches import Circle

from jaxtrack.plots.style import COLOURS, INK, MARKERS, WIDTH_IN, dress, style
from jaxtrack.types import Scan

_POINTS = {"color": INK, "s": 5, "linewidths": 0, "zorder": 3}


def template_frames(
    clouds: Scan, places_m: Any, *, radius_m: float = 1.0, title: str = ""
) -> Figure:
    """Return the first frames' points about the target, with the circle of the template.

    Args:
        clouds: T frames, stacked; one panel each.
        places_m: [T, 2] of the target.
        radius_m: of the template.
        title: of the figure.

    Example:
        >>> ones = np.ones((3, 4), bool)
        >>> clouds = Scan(np.arange(3.0), np.ones(3, bool), np.ones((3, 4, 2)), ones)
        >>> len(template_frames(clouds, np.ones((3, 2))).axes)
        3

    Source: Zernike moment paper (2023), figures 9, 12 and 16.
    """
    frames = len(clouds.time_s)
    with style():
        figure = Figure(figsize=(WIDTH_IN, 2.9), layout="constrained")
        row: Any = np.ravel(figure.subplots(1, frames, squeeze=False))
        for k, axes in enumerate(row):
            place = np.asarray(places_m)[k]
            axes.scatter(*_seen(clouds, k)[:, ::-1].T, **{**_POINTS, "s": 9})
            ring = Circle(tuple(place[::-1]), radius_m, fill=False, ls="--", color=COLOURS[0])
            axes.add_patch(ring)
            axes.plot(*place[::-1], "+", color=COLOURS[1], ms=8)
            axes.set_xlim(place[1] - 2 * radius_m, place[1] + 2 * radius_m)
            axes.set_ylim(place[0] - 2 * radius_m, place[0] + 2 * radius_m)
            _map(axes, f"frame {k + 1}")
        figure.suptitle(title, x=0.01, ha="left", fontweight="bold", fontsize=10)
    return figure


def pursuit(
    clouds: Scan,
    truth_m: Any,
    position_m: Any,
    particles_m: Any,
    *,
    until: Sequence[int],
    vehicle_m: Any = None,
    title: str = "",
) -> Figure:
    """Return the tracking process: particles over the sonar's points, a panel a moment.

    Args:
        clouds: T frames, stacked.
        truth_m: [T, 2].
        position_m: [T, 2] estimates.
        particles_m: [T, N, 2].
        until: the number of frames of each panel, whose last one's points and particles are shown.
        vehicle_m: [T, 2] of the sonar's carrier, drawn if it comes near.
        title: of the figure.

    Example:
        >>> clouds = Scan(np.arange(2.0), np.ones(2, bool), np.ones((2, 4, 2)), np.ones((2, 4), bool))
        >>> one = np.ones((2, 2))
        >>> figure = pursuit(clouds, one, one, np.ones((2, 9, 2)), until=(1, 2))
        >>> figure.axes[1].get_title(loc="left")
        '2 frames'

    Source: Zernike moment paper (2023), figures 10, 13 and 17.
    """  # noqa: E501
    truth, position = np.asarray(truth_m), np.asarray(position_m)
    every = np.concatenate([truth, position])
    low, high = every.min(0) - 2.5, every.max(0) + 2.5
    wide = high[1] - low[1] > 1.4 * (high[0] - low[0])
    shape = (len(until), 1) if wide else (1, len(until))
    aspect = (high[0] - low[0]) / (high[1] - low[1])
    size = (WIDTH_IN, 0.9 + len(until) * (6.2 * aspect + 0.6)) if wide else (WIDTH_IN, 3.6)
    with style():
        figure = Figure(figsize=size, layout="constrained")
        panels: Any = np.ravel(figure.subplots(*shape, squeeze=False))
        for axes, count in zip(panels, until, strict=True):
            last = count - 1
            axes.scatter(*_seen(clouds, last)[:, ::-1].T, **_POINTS, label="points")
            cloud = np.asarray(particles_m)[last]
            axes.scatter(
                *cloud[:, ::-1].T, s=4, color=COLOURS[2], alpha=0.6, lw=0, label="particles"
            )
            dashed = {"color": INK, "ls": (0, (4, 2)), "lw": 0.9}
            axes.plot(*truth[:count, ::-1].T, **dashed, label="truth")
            axes.plot(*truth[last, ::-1], "x", color=INK, ms=7, mew=1.6, zorder=5)
            axes.plot(
                *position[:count, ::-1].T, "o-", color=COLOURS[1], ms=2.5, lw=1.0, label="estimate"
            )
            if vehicle_m is not None and _within(vehicle_m, low, high):
                path = np.asarray(vehicle_m)[:count, ::-1]
                axes.plot(*path.T, color=COLOURS[3], lw=1.2, label="vehicle")
            axes.set_xlim(low[1], high[1])
            axes.set_ylim(low[0], high[0])
            _map(axes, f"{count} frame{'s' if count > 1 else ''}")
        handles, labels = panels[0].get_legend_handles_labels()
        figure.legend(handles, labels, loc="outside lower center", ncols=5, markerscale=2)
        figure.suptitle(title, x=0.01, ha="left", fontweight="bold", fontsize=10)
    return figure


def target_paths(truth_m: Any, paths_m: Mapping[str, Any], *, title: str = "") -> Figure:
    """Return a map of the true path (dashed) and what each tracker made of it.

    Args:
        truth_m: [T, 2].
        paths_m: [T, 2] by tracker.
        title: of the figure.

    Example:
        >>> figure = target_paths(np.eye(2), {"hu": np.eye(2)})
        >>> figure.axes[0].get_xlabel()
        'east, m'

    Source: Zernike moment paper (2023), figures 14 and 18.
    """
    with style():
        figure = Figure(figsize=(WIDTH_IN, 4.2), layout="constrained")
        axes = figure.add_subplot()
        for k, (name, path) in enumerate(paths_m.items()):
            axes.plot(*np.asarray(path)[:, ::-1].T, color=COLOURS[k % 7], marker=MARKERS[k % 7],
                      ms=3, lw=1.0, alpha=0.85, label=name)  # fmt: skip
        axes.plot(*np.asarray(truth_m)[:, ::-1].T, color=INK, ls=(0, (4, 2)), label="truth")
        _map(axes, title, adjustable="datalim")
        figure.legend(loc="outside lower center", ncols=3)
    return figure


def deviations(time_s: Any, deviation_m: Mapping[str, Any], *, title: str = "") -> Figure:
    """Return the deviations in X and in Y over time, truth less estimate.

    Args:
        time_s: [T].
        deviation_m: [T, 2] by tracker.
        title: of the figure.

    Example:
        >>> deviations([0.0, 6.0], {"hu": np.zeros((2, 2))}).axes[1].get_ylabel()
        'Y deviation, m'

    Source: Zernike moment paper (2023), figures 11, 15 and 19.
    """
    with style():
        figure = Figure(figsize=(WIDTH_IN, 4.4), layout="constrained")
        column: Any = figure.subplots(2, 1, sharex=True)
        for axis, axes in enumerate(column):
            for k, (name, values) in enumerate(deviation_m.items()):
                axes.plot(time_s, np.asarray(values)[:, axis], color=COLOURS[k % 7], lw=1.2,
                          marker=MARKERS[k % 7], ms=3, label=name)  # fmt: skip
            axes.axhline(0.0, color=INK, lw=0.7)
            axes.set_ylabel(f"{'XY'[axis]} deviation, m")
            dress(axes)
        column[-1].set_xlabel("time, s")
        handles, labels = column[0].get_legend_handles_labels()
        figure.legend(handles, labels, loc="outside lower center", ncols=3)
        figure.suptitle(title, x=0.01, ha="left", fontweight="bold", fontsize=10)
    return figure


def turned_steps(steps_m: Any, turned_m: Any, apart_m: Any, *, title: str = "") -> Figure:
    """Return particles' steps as they are drawn and as the optimised transition turns them.

    Args:
        steps_m: [N, 2] as drawn.
        turned_m: [N, 2] the same, turned.
        apart_m: [2] between the target's last two places, drawn as an arrow.
        title: of the figure.

    Example:
        >>> turned_steps(np.zeros((4, 2)), np.zeros((4, 2)), [0.6, 0.1]).axes[1].get_title(loc="left")
        'turned'

    Source: Zernike moment paper (2023), figure 6 and section 2.3.3.
    """  # noqa: E501
    with style():
        figure = Figure(figsize=(WIDTH_IN, 3.7), layout="constrained")
        row: Any = figure.subplots(1, 2, sharex=True, sharey=True)
        for axes, steps, name in zip(row, (steps_m, turned_m), ("drawn", "turned"), strict=True):
            axes.scatter(*np.asarray(steps).T, s=5, color=COLOURS[2], lw=0, alpha=0.7)
            arrow = {"arrowstyle": "-|>", "color": COLOURS[1], "lw": 1.8}
            axes.annotate("", xy=tuple(np.asarray(apart_m)), xytext=(0, 0), arrowprops=arrow)
            axes.set_title(name, loc="left")
            axes.set_aspect("equal")
            axes.set_xlabel("X, m")
            dress(axes)
        row[0].set_ylabel("Y, m")
        figure.suptitle(title, x=0.01, ha="left", fontweight="bold", fontsize=10)
    return figure


def _seen(clouds: Scan, frame: int) -> np.ndarray:
    return np.asarray(clouds.position_m)[frame][np.asarray(clouds.mask)[frame]]


def _within(path_m: Any, low: np.ndarray, high: np.ndarray) -> bool:
    path = np.asarray(path_m)
    return bool(((path >= low) & (path <= high)).all(1).any())


def _map(axes: Axes, title: str, *, adjustable: Any = "box") -> None:
    axes.set_title(title, loc="left")
    axes.set_aspect("equal", adjustable=adjustable)
    axes.set_xlabel("east, m")
    axes.set_ylabel("north, m")
    dress(axes)
