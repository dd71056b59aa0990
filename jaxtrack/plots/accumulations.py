"""Accumulators as three-dimensional histograms, one panel a method."""

from collections.abc import Mapping, Sequence
from typing import Any

import matplotlib
import numpy as np
from matplotlib.figure import Figure
from matplotlib.ticker import MaxNLocator
from mpl_toolkits.mplot3d.axes3d import Axes3D

from jaxtrack.plots.style import COLOURS, FAINT, INK, WIDTH_IN, style

_BARS = 48  # along each axis; more cannot be told apart on a page


def accumulations(
    panels: Mapping[str, Any],
    rho_max_m: float,
    *,
    title: str = "",
    marks: Sequence[tuple[float, float]] = (),
) -> Figure:
    """Return accumulators as bars over (ρ, θ); a bar is the largest of the cells it stands for.

    Args:
        panels: [n_θ, n_ρ] accumulator of each name, θ from 0 to π, ρ from −ρ_max to ρ_max.
        rho_max_m: the largest |ρ|, metres.
        title: of the figure.
        marks: (ρ, θ) of the true lines, metres and radians, shown by a needle.

    Example:
        >>> figure = accumulations({"empty": np.zeros((90, 100))}, 4000.0)
        >>> figure.axes[0].get_xlabel()
        'ρ, km'

    Source: neutrosophic Hough transform (2018), figures 7–10 and 15.
    """
    columns = min(max(len(panels), 1), 2)
    rows = max(-(-len(panels) // columns), 1)
    with style():
        figure = Figure(figsize=(WIDTH_IN, 3.1 * rows + 0.4 if columns == 2 else 4.6))
        for place, (name, votes) in enumerate(panels.items()):
            axes = figure.add_subplot(rows, columns, place + 1, projection="3d")
            _panel(axes, name, np.asarray(votes, np.float64), rho_max_m / 1000.0, marks)  # type: ignore[arg-type]
        figure.subplots_adjust(0.0, 0.07, 0.94, 0.94, wspace=0.06, hspace=0.05)
        figure.suptitle(title, x=0.02, ha="left", fontsize=10, fontweight="bold")
        if marks and panels:
            needle = figure.axes[0].get_lines()[0]
            figure.legend([needle], ["true line"], loc="lower center")
    return figure


def _panel(
    axes: Axes3D, name: str, votes: np.ndarray, rho_max: float, marks: Sequence[tuple[float, float]]
) -> None:
    height, theta, rho = _coarse(votes, rho_max)
    j, i = np.nonzero(height > 0)
    top = float(height.max(initial=0.0)) or 1.0
    if len(i):
        d_rho, d_theta = rho[1] - rho[0], theta[1] - theta[0]
        values = height[j, i]
        colours = matplotlib.colormaps["viridis"](0.1 + 0.85 * values / top)
        zero = np.zeros_like(values)
        axes.bar3d(rho[i], theta[j], zero, d_rho, d_theta, values, color=colours, linewidth=0)
    for mark_m, angle in marks:
        at = mark_m / 1000.0
        axes.plot([at, at], [angle, angle], [0, 1.15 * top], color=COLOURS[1], lw=1.0, zorder=1e6)
        axes.plot([at], [angle], [1.15 * top], "v", color=COLOURS[1], ms=5, zorder=1e6)
    axes.set(xlim=(-rho_max, rho_max), ylim=(0, np.pi), zlim=(0, 1.15 * top))
    axes.set_yticks([0, np.pi / 2, np.pi], ["0", "π/2", "π"])
    axes.locator_params(axis="x", nbins=5)
    axes.zaxis.set_major_locator(MaxNLocator(5))
    axes.set_xlabel("ρ, km", labelpad=0)
    axes.set_ylabel("θ, rad", labelpad=0)
    axes.set_zlabel("votes", labelpad=0)
    axes.tick_params(labelsize=8, pad=0, color=INK, labelcolor=INK)
    axes.view_init(elev=28, azim=-58)
    axes.set_box_aspect((1.25, 1.25, 0.8), zoom=1.05)  # pyright: ignore[reportArgumentType]
    for axis in (axes.xaxis, axes.yaxis, axes.zaxis):
        axis.set_pane_color((1.0, 1.0, 1.0, 0.0))  # pyright: ignore[reportAttributeAccessIssue]
        # There is no public way to colour the grid of one three-dimensional figure.
        axis._axinfo["grid"].update(color=FAINT, linewidth=0.5)  # pyright: ignore
    axes.set_title(name, loc="left", x=0.08, y=0.9)


def _coarse(votes: np.ndarray, rho_max: float) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return block maxima [≤ 48, ≤ 48], and the blocks' edges along θ and ρ."""
    n_theta, n_rho = (min(n, _BARS) for n in votes.shape)
    edges = [
        np.linspace(0, n, bars + 1)[:-1].astype(int)
        for n, bars in zip(votes.shape, (n_theta, n_rho), strict=True)
    ]
    height = np.maximum.reduceat(np.maximum.reduceat(votes, edges[0], axis=0), edges[1], axis=1)
    theta, rho = np.linspace(0, np.pi, n_theta + 1), np.linspace(-rho_max, rho_max, n_rho + 1)
    return height, theta, rho
