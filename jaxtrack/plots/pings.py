"""A sweep of a mechanically scanned sonar from above: intensities, the cloud, and the truth."""

from collections.abc import Mapping
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from jaxtrack.numerics.checks import check_array, check_choice
from jaxtrack.plots.style import COLOURS, INK, WIDTH_IN, dress, say_empty, style
from jaxtrack.sensors.scanning_sonar import ScanningSonar
from jaxtrack.types import Pings, Scan, Truth

_NAMES = {"x_y": ("x", "y"), "north_east": ("east", "north")}
_RANGE_DB = (0.0, 35.0)


def pings_map(
    pings: Pings,
    sonar: ScanningSonar,
    cloud: Scan | None = None,
    truth: Truth | None = None,
    *,
    paths_m: Mapping[str, Any] | None = None,
    around_m: float | None = None,
    title: str = "",
    axes: str = "north_east",
) -> Figure:
    """Return a map of one sweep's intensities where its pings' poses put them.

    Args:
        pings: Q pings of R bins, of one sweep.
        sonar: its scope, step and mounting.
        cloud: points, such as `sensors.cloud_of_pings` gives; drawn as circles.
        truth: where targets were in this sweep, of any number of times; drawn as crosses.
        paths_m: [T, K, 2] positions of tracks by method, drawn as lines.
        around_m: half the width of a window around the first true target; None: the whole sector.
        title: of the figure.
        axes: `"north_east"` (x north is drawn upwards, y east to the right) or `"x_y"`.

    Raises:
        ValueError: unknown axes, a shape that does not fit, or a window without a true target.

    Example:
        >>> import jax
        >>> from jaxtrack.sensors import IMAGENEX_881L, dragged_bucket
        >>> run = dragged_bucket(jax.random.key(0), "static", frames=1)
        >>> sweep = jax.tree.map(lambda x: x[0], run.pings)
        >>> pings_map(sweep, IMAGENEX_881L.sonar, title="A bucket").axes[0].get_xlabel()
        'east, m'

    Source: Zernike moment paper (2023), figures 9, 12 and 16.
    """
    check_choice("axes", axes, tuple(_NAMES))
    check_array("pings.intensity", pings.intensity, shape=("Q", "R"))
    order = [0, 1] if axes == "x_y" else [1, 0]
    live = np.asarray(pings.mask)
    true = np.zeros((0, 2))
    if truth is not None:
        true = np.asarray(truth.state)[..., :2][np.asarray(truth.mask)][:, order]
    if around_m is not None and not len(true):
        raise ValueError(f"around_m: got {around_m} without a true target, want None or a truth")
    with style():
        figure = Figure(layout="constrained")
        plane = figure.add_subplot()
        # Cells end where the sector does, and a little more is shown.
        plane.use_sticky_edges = False
        plane.margins(0.03)
        if live.any():
            _intensities(figure, plane, pings, live, sonar, order)
        else:
            say_empty(plane, "no pings")
        if cloud is not None:
            at = np.asarray(cloud.position_m)[np.asarray(cloud.mask)][:, order]
            kept = {"mfc": "none", "mec": COLOURS[1], "ms": 3.0, "mew": 0.6}
            plane.plot(*at.T, "o", label="cloud", zorder=3, **kept)
        for place, (name, path) in enumerate((paths_m or {}).items()):
            tracks = np.asarray(path)[..., order]  # [T, K, 2]
            colour = COLOURS[(place + 2) % len(COLOURS)]
            for number in range(tracks.shape[1]):
                label = name if number == 0 else None
                plane.plot(*tracks[:, number].T, color=colour, lw=1.2, label=label, zorder=3)
        if len(true):
            plane.plot(*true.T, "x", color=INK, ms=8, mew=1.6, label="truth", zorder=4)
        if around_m is not None:
            plane.set_xlim(true[0, 0] - around_m, true[0, 0] + around_m)
            plane.set_ylim(true[0, 1] - around_m, true[0, 1] + around_m)
        for axis, name in zip((plane.xaxis, plane.yaxis), _NAMES[axes], strict=True):
            axis.set_label_text(f"{name}, m")
        plane.set_aspect("equal")
        wide, high = np.ptp(plane.get_xlim()), np.ptp(plane.get_ylim())
        # The plane fills the figure; beside it stand a bar and labels.
        height_in = float(np.clip((WIDTH_IN - 1.8) * high / wide, 3.0, 6.0))
        figure.set_size_inches(max(height_in * wide / high + 1.8, 4.8), height_in + 1.1)
        dress(plane)
        plane.set_title(title, loc="left", fontweight="bold")
        handles, labels = plane.get_legend_handles_labels()
        if handles:
            figure.legend(handles, labels, loc="outside lower center", ncols=3)
    return figure


def _intensities(
    figure: Figure,
    plane: Axes,
    pings: Pings,
    live: np.ndarray,
    sonar: ScanningSonar,
    order: list[int],
) -> None:
    """Draw every cell as the quadrilateral between its neighbours' beams."""
    pick = lambda x: np.asarray(x, np.float64)[live]
    intensity, heading = pick(pings.intensity), np.unwrap(pick(pings.pose.heading_rad))
    bearing = pick(pings.bearing_rad)
    step = float(sonar.step_rad) * (-1.0 if bearing[-1] < bearing[0] else 1.0)
    axis = _edges((heading + bearing)[:, None] + float(sonar.mount_rad), step)
    turn = _edges(heading[:, None], 0.0)
    stand = _edges(pick(pings.pose.position_m), 0.0)
    arm = np.asarray(sonar.mount_m, np.float64)
    cos, sin = np.cos(turn), np.sin(turn)
    stand = stand + np.concatenate([cos * arm[0] - sin * arm[1], sin * arm[0] + cos * arm[1]], 1)
    bins = intensity.shape[1]
    range_m = float(sonar.range_max_m) / bins * np.arange(bins + 1)
    corner = np.stack([np.cos(axis) * range_m, np.sin(axis) * range_m], -1) + stand[:, None]
    level_db = 20 * np.log10(np.maximum(intensity, 1e-3))
    low, high = _RANGE_DB
    x, y = np.moveaxis(corner[..., order], -1, 0)
    plane.plot(*stand[:, order].T, color=COLOURS[0], lw=3.0, label="sonar", zorder=4)
    mesh = plane.pcolormesh(
        x, y, level_db, cmap="Greys", vmin=low, vmax=high, rasterized=True, zorder=1
    )
    bar = figure.colorbar(mesh, ax=plane, shrink=0.75, aspect=30, pad=0.02, extend="both")
    bar.set_label("intensity over reverberation, dB")
    bar.ax.tick_params(labelsize=8.5, width=0.7, length=3)


def _edges(values: np.ndarray, step: float) -> np.ndarray:
    """Return what lies between neighbours, [Q + 1, D], and half a step beyond the outer ones."""
    ends = values[:1] - step / 2, values[-1:] + step / 2
    return np.concatenate([ends[0], (values[1:] + values[:-1]) / 2, ends[1]])
