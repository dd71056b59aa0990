"""Two targets that meet, and what became of their tracks: by method, by target, by coordinate."""

from collections.abc import Mapping
from typing import Any

import numpy as np
from matplotlib.figure import Figure

from jaxtrack.plots.style import COLOURS, INK, MARKERS, WIDTH_IN, dress, style
from jaxtrack.types import Scan, Truth

_COLUMNS = 3


def meetings(scans: Scan, truth: Truth, paths_m: Mapping[str, Any], *, title: str = "") -> Figure:
    """Return maps of detections, true paths (dashed) and tracks, a panel a method.

    Args:
        scans: T looks stacked.
        truth: T looks at K targets.
        paths_m: [T, K, 2] positions of the tracks by method.
        title: of the figure.

    Example:
        >>> truth = Truth(np.arange(2.0), np.ones((2, 1, 4)), np.ones((2, 1), bool))
        >>> scans = Scan(np.arange(2.0), np.ones(2, bool), np.ones((2, 1, 2)), np.ones((2, 1), bool))
        >>> figure = meetings(scans, truth, {"jpda": np.ones((2, 1, 2))})
        >>> figure.axes[0].get_title(loc="left")
        'jpda'

    Source: clustering cloud-like model (2019), figures 8 and 12.
    """  # noqa: E501
    rows = -(-len(paths_m) // _COLUMNS)
    counts = np.asarray(scans.mask) & np.asarray(scans.valid)[:, None]
    seen = np.asarray(scans.position_m)[counts]
    real = np.asarray(truth.state)[..., :2]
    each_in = 0.55 + 0.9 * WIDTH_IN / _COLUMNS * _steepness(seen, real)
    with style():
        figure = Figure(figsize=(WIDTH_IN, 0.8 + each_in * rows), layout="constrained")
        grid: Any = figure.subplots(rows, _COLUMNS, sharex=True, sharey=True, squeeze=False)
        for axes in grid.ravel()[len(paths_m) :]:
            axes.set_visible(False)
        for axes, (name, path) in zip(grid.ravel(), paths_m.items(), strict=False):
            axes.scatter(*seen.T, s=3, color="#999999", linewidths=0, label="detections")
            for target in range(real.shape[1]):
                label = "truth" if target == 0 else None
                axes.plot(*real[:, target].T, color=INK, ls=(0, (4, 2)), lw=0.9, label=label)
                colour, track = COLOURS[target % len(COLOURS)], np.asarray(path)[:, target]
                axes.plot(*track.T, color=colour, lw=1.6, alpha=0.85, label=f"track {target + 1}")
            axes.set_title(name, loc="left")
            axes.set_aspect("equal")
            dress(axes)
        for axes in grid[:, 0]:
            axes.set_ylabel("y, m")
        for axes in grid[-1]:
            axes.set_xlabel("x, m")
        handles, labels = grid[0, 0].get_legend_handles_labels()
        figure.legend(handles, labels, loc="outside lower center", ncols=4)
        figure.suptitle(title, x=0.01, ha="left", fontweight="bold", fontsize=10)
    return figure


def meeting_tracks(truth: Truth, paths_m: Mapping[str, Any], *, title: str = "") -> Figure:
    """Return maps of where each target was and where the methods' tracks had it, a panel a target.

    Args:
        truth: T looks at K targets.
        paths_m: [T, K, 2] positions of the tracks by method.
        title: of the figure.

    Example:
        >>> truth = Truth(np.arange(2.0), np.ones((2, 2, 4)), np.ones((2, 2), bool))
        >>> figure = meeting_tracks(truth, {"jpda": np.ones((2, 2, 2))})
        >>> [axes.get_title(loc="left") for axes in figure.axes]
        ['target 1', 'target 2']

    Source: clustering cloud-like model (2019), figures 9 and 13.
    """
    real = np.asarray(truth.state)[..., :2]
    height_in = 1.4 + 0.9 * WIDTH_IN / real.shape[1] * _steepness(real)
    with style():
        figure = Figure(figsize=(WIDTH_IN, height_in), layout="constrained")
        row = figure.subplots(1, real.shape[1], sharex=True, sharey=True, squeeze=False)[0]
        for target, axes in enumerate(row):
            axes.plot(*real[:, target].T, color=INK, ls=(0, (4, 2)), lw=0.9, label="truth")
            for k, (name, path) in enumerate(paths_m.items()):
                x, y = np.asarray(path)[:, target].T
                _curve(axes, x, y, k, name)
            axes.set_title(f"target {target + 1}", loc="left")
            axes.set_aspect("equal")
            axes.set_xlabel("x, m")
            dress(axes)
        row[0].set_ylabel("y, m")
        figure.legend(*row[0].get_legend_handles_labels(), loc="outside lower center", ncols=4)
        figure.suptitle(title, x=0.01, ha="left", fontweight="bold", fontsize=10)
    return figure


def meeting_errors(
    truth: Truth, paths_m: Mapping[str, Any], *, target: int, title: str = ""
) -> Figure:
    """Return how far the methods' tracks of a target are from it in x and y, look by look.

    Args:
        truth: T looks at K targets.
        paths_m: [T, K, 2] positions of the tracks by method.
        target: which, from 0.
        title: of the figure.

    Example:
        >>> truth = Truth(np.arange(2.0), np.ones((2, 1, 4)), np.ones((2, 1), bool))
        >>> figure = meeting_errors(truth, {"jpda": np.full((2, 1, 2), 1.5)}, target=0)
        >>> print(figure.axes[0].get_ylabel(), figure.axes[1].lines[0].get_ydata())
        x, track − truth, m [0.5 0.5]

    Source: clustering cloud-like model (2019), figures 10, 11, 14 and 15.
    """
    real = np.asarray(truth.state)[:, target, :2]
    with style():
        figure = Figure(figsize=(WIDTH_IN, 3.2), layout="constrained")
        row: Any = figure.subplots(1, 2, sharex=True, sharey=True)
        for axis, axes in enumerate(row):
            for k, (name, path) in enumerate(paths_m.items()):
                off_m = np.asarray(path)[:, target, axis] - real[:, axis]
                _curve(axes, np.arange(len(off_m)), off_m, k, name)
            axes.set_ylabel(f"{'xy'[axis]}, track − truth, m")
            axes.set_xlabel("look")
            dress(axes)
        figure.legend(*row[0].get_legend_handles_labels(), loc="outside lower center", ncols=4)
        figure.suptitle(title, x=0.01, ha="left", fontweight="bold", fontsize=10)
    return figure


def _steepness(*places_m: np.ndarray) -> float:
    """Return how high a map of places [..., 2] is for its width, at most as high as wide."""
    every = np.concatenate([at.reshape(-1, 2) for at in places_m])
    wide, high = np.ptp(every, axis=0)
    return min(high / wide, 1.0) if wide > 0 else 1.0


def _curve(axes: Any, x: np.ndarray, y: np.ndarray, k: int, name: str) -> None:
    look = {"color": COLOURS[k % 7], "marker": MARKERS[k % 7]}
    axes.plot(x, y, **look, ms=3, lw=1.1, alpha=0.85, label=name)
