"""A scene from above: detections, the true paths, and the tracks that were found."""

from typing import Any

import matplotlib
import numpy as np
from matplotlib.axes import Axes
from matplotlib.cm import ScalarMappable
from matplotlib.colors import ListedColormap, Normalize
from matplotlib.figure import Figure
from matplotlib.ticker import MaxNLocator

from jaxtrack.numerics.checks import check_choice
from jaxtrack.plots.style import COLOURS, INK, WIDTH_IN, dress, say_empty, style
from jaxtrack.types import Scan, Tracks, Truth

_NAMES = {"x_y": ("x", "y"), "north_east": ("east", "north")}
_KILOMETRES_FROM = 2000.0  # of the larger side, metres
_NAMED = 10  # tracks that a legend names


def scene(
    scans: Scan | None,
    truth: Truth | None = None,
    tracks: Tracks | None = None,
    *,
    smoothed_m: Any = None,
    title: str = "",
    axes: str = "x_y",
) -> Figure:
    """Return a map of detections (coloured by time), true paths (dashed) and tracks.

    Args:
        scans: K looks stacked.
        truth: T times of the targets.
        tracks: M tracks, an arrow shows where each is heading; or tables of them stacked [T], each
            identity a line.
        smoothed_m: [M, K, 2] where the tracks were at every look; None: on a straight line.
        title: of the figure.
        axes: `"x_y"` or `"north_east"` (x north is drawn upwards, y east to the right).

    Raises:
        ValueError: unknown axes.

    Example:
        >>> from jaxtrack.sensors import crossing_targets
        >>> figure = scene(None, crossing_targets().truth, title="Three crossing targets")
        >>> figure.axes[0].get_xlabel()
        'x, km'

    Source: neutrosophic Hough transform (2018), figures 4–6 and 12–14.
    """
    check_choice("axes", axes, tuple(_NAMES))
    order = [0, 1] if axes == "x_y" else [1, 0]
    place = lambda position_m: np.asarray(position_m, np.float64)[..., :2][..., order]
    shown: list[np.ndarray] = []
    with style():
        figure = Figure(figsize=(WIDTH_IN, 4.5), layout="constrained")
        # Axes of fixed proportions may grow into the title by a few dots.
        figure.get_layout_engine().set(h_pad=0.1)  # type: ignore[union-attr, call-arg]
        plane = figure.add_subplot()
        if scans is not None:
            shown.append(_detections(figure, plane, scans, place))
        if truth is not None:
            shown.append(_truth(plane, truth, place))
        if tracks is not None and np.ndim(tracks.mask) == 2:
            shown.append(_lives(plane, tracks, place))
        elif tracks is not None:
            shown.append(_tracks(plane, tracks, _paths_m(tracks, scans, truth, smoothed_m), place))
        everything = np.concatenate([np.zeros((0, 2)), *shown])
        _frame(figure, plane, everything)
        far = len(everything) > 0 and np.ptp(everything, axis=0).max() >= _KILOMETRES_FROM
        for axis, name in zip((plane.xaxis, plane.yaxis), _NAMES[axes], strict=True):
            axis.set_label_text(f"{name}, {'km' if far else 'm'}")
            if far:
                axis.set_major_formatter(lambda metres, _: f"{metres / 1000:g}")
        dress(plane)
        plane.set_title(title, loc="left", fontweight="bold")
        handles, labels = plane.get_legend_handles_labels()
        if handles:
            figure.legend(handles, labels, loc="outside lower center", ncols=min(len(handles), 6))
        if not len(everything):
            say_empty(plane, "no detections, no tracks")
    return figure


def _detections(figure: Figure, plane: Axes, scans: Scan, place: Any) -> np.ndarray:
    counts = np.asarray(scans.mask) & np.asarray(scans.valid)[:, None]
    position = place(scans.position_m)[counts]
    if not len(position):
        return position
    time_s = np.asarray(scans.time_s, np.float64)
    looks = np.broadcast_to(time_s[:, None], counts.shape)[counts]
    times = Normalize(time_s.min(), max(time_s.max(), time_s.min() + 1e-9))
    # Without its light end, which would vanish against white.
    colours = ListedColormap(matplotlib.colormaps["cividis"](np.linspace(0.0, 0.85, 128)))
    plane.scatter(*position.T, c=looks, cmap=colours, norm=times, s=10, linewidths=0, zorder=2)
    bar = figure.colorbar(
        ScalarMappable(times, colours), ax=plane, shrink=0.75, aspect=30, pad=0.02
    )
    bar.set_label("time of the detection, s")
    bar.outline.set_visible(False)  # type: ignore[operator]
    bar.ax.tick_params(labelsize=8.5, width=0.7, length=3)
    return position


def _truth(plane: Axes, truth: Truth, place: Any) -> np.ndarray:
    position, mask = place(truth.state), np.asarray(truth.mask)
    for target in range(mask.shape[1]):
        path = position[mask[:, target], target]
        label = "truth" if target == 0 else None
        plane.plot(*path.T, color=INK, ls=(0, (4, 2)), lw=1.0, zorder=3, label=label)
        plane.plot(*path.T, "o", mfc="none", mec=INK, ms=6, mew=0.7, zorder=3)
    return position[mask]


def _tracks(plane: Axes, tracks: Tracks, path_m: np.ndarray, place: Any) -> np.ndarray:
    live = np.flatnonzero(np.asarray(tracks.mask))
    mean = np.asarray(tracks.mean, np.float64)
    ends = [np.zeros((0, 2))]
    for n, slot in enumerate(live):
        colour = COLOURS[n % len(COLOURS)]
        path, here = place(path_m[slot]), place(mean[slot, :2])
        label = f"track {np.asarray(tracks.identity)[slot]}"
        plane.plot(*path.T, color=colour, lw=2.2, alpha=0.85, zorder=4, label=label)
        # A tenth of the way it has come, so that slow and fast scenes look alike.
        ahead = (
            place(mean[slot, 2:4]) * max(_duration_s(path_m[slot], mean[slot, 2:4]), 1e-9) * 0.12
        )
        arrow = {"arrowstyle": "-|>", "color": colour, "lw": 2.2, "shrinkA": 0, "shrinkB": 0}
        plane.annotate("", here + ahead, here, arrowprops=arrow, zorder=5)
        ends += [path, here[None], (here + ahead)[None]]
    return np.concatenate(ends)


def _lives(plane: Axes, tracks: Tracks, place: Any) -> np.ndarray:
    mask, identity = np.asarray(tracks.mask), np.asarray(tracks.identity)
    position = place(tracks.mean)
    for n, number in enumerate(np.unique(identity[mask])):
        path = position[mask & (identity == number)]
        label = f"track {number}" if n < _NAMED else None
        colour = COLOURS[n % len(COLOURS)]
        plane.plot(*path.T, color=colour, lw=1.8, alpha=0.85, zorder=4, label=label)
        plane.plot(*path[-1], "o", color=colour, ms=4, zorder=5)
    return position[mask]


def _duration_s(path_m: np.ndarray, velocity_m_s: np.ndarray) -> float:
    speed = float(np.hypot(*velocity_m_s))
    length = float(np.hypot(*(path_m[-1] - path_m[0]))) if len(path_m) else 0.0
    return length / speed if speed > 0 else 0.0


def _paths_m(
    tracks: Tracks, scans: Scan | None, truth: Truth | None, smoothed_m: Any
) -> np.ndarray:
    """Return where the tracks were at every look, [M, K, 2]."""
    if smoothed_m is not None:
        return np.asarray(smoothed_m, np.float64)
    seen = scans if scans is not None else truth
    end_s = float(tracks.time_s)
    dt = np.zeros(1) if seen is None else np.asarray(seen.time_s, np.float64) - end_s
    mean = np.asarray(tracks.mean, np.float64)
    return mean[:, None, :2] + mean[:, None, 2:4] * dt[None, :, None]


def _frame(figure: Figure, plane: Axes, everything: np.ndarray) -> None:
    """Show everything in true proportions, with a margin, in a figure of fitting height."""
    if not len(everything):
        plane.set(xlim=(0, 1), ylim=(0, 1))
        return
    low, high = everything.min(axis=0), everything.max(axis=0)
    span = max(float((high - low).max()), 1e-3)
    # Where all lies on a line the plane still has some width.
    half = np.maximum((high - low) / 2 + 0.04 * span, 0.15 * span)
    centre = (low + high) / 2
    plane.set(
        xlim=(centre - half)[0] + [0, 2 * half[0]], ylim=(centre - half)[1] + [0, 2 * half[1]]
    )
    plane.set_aspect("equal")
    plane.xaxis.set_major_locator(MaxNLocator(8, steps=[1, 2, 5, 10]))
    plane.yaxis.set_major_locator(MaxNLocator(6, steps=[1, 2, 5, 10]))
    figure.set_figheight(float(np.clip(1.2 + 5.6 * half[1] / half[0], 3.0, 7.5)))
