"""Two targets that meet, and what became of their tracks, a panel a method."""

from collections.abc import Mapping
from typing import Any

import numpy as np
from matplotlib.figure import Figure

from jaxtrack.plots.style import COLOURS, INK, WIDTH_IN, dress, style
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

    Source: clustering cloud-like model (2019), figures 8 to 15.
    """  # noqa: E501
    rows = -(-len(paths_m) // _COLUMNS)
    counts = np.asarray(scans.mask) & np.asarray(scans.valid)[:, None]
    seen = np.asarray(scans.position_m)[counts]
    real = np.asarray(truth.state)[..., :2]
    with style():
        figure = Figure(figsize=(WIDTH_IN, 0.5 + 2.3 * rows), layout="constrained")
        grid: Any = figure.subplots(rows, _COLUMNS, sharex=True, sharey=True, squeeze=False)
        for axes in grid.ravel()[len(paths_m) :]:
            axes.set_visible(False)
        for axes, (name, path) in zip(grid.ravel(), paths_m.items(), strict=False):
            axes.scatter(*seen.T, s=3, color="#999999", linewidths=0, label="detections")
            for target in range(real.shape[1]):
                label = "truth" if target == 0 else None
                axes.plot(*real[:, target].T, color=INK, ls=(0, (4, 2)), lw=0.9, label=label)
                colour, track = COLOURS[target % len(COLOURS)], np.asarray(path)[:, target]
                axes.plot(*track.T, color=colour, lw=1.6, alpha=0.85, label=f"track {target}")
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
