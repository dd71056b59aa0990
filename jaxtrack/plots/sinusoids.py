"""What the Hough transform is: points of a line, and their sinusoids that meet in one point."""

from typing import Any

import numpy as np
from matplotlib.figure import Figure
from matplotlib.ticker import MaxNLocator

from jaxtrack.plots.style import COLOURS, INK, WIDTH_IN, dress, say_empty, style


def sinusoids(points_m: Any, *, title: str = "") -> Figure:
    """Return points in the plane beside their sinusoids ρ(θ) = x cos θ + y sin θ.

    Args:
        points_m: [P, 2]; the line drawn is the one nearest to them.
        title: of the figure.

    Example:
        >>> figure = sinusoids([[0.0, 8.0], [9.0, 8.0], [20.0, 8.0]])
        >>> print(len(figure.axes))
        2

    Source: neutrosophic Hough transform (2018), figure 2 and equation 6.
    """
    points_m = np.asarray(points_m, np.float64).reshape(-1, 2)
    scale, unit = (1000.0, "km") if np.abs(points_m).max(initial=0.0) >= 2000.0 else (1.0, "m")
    points = points_m / scale
    theta = np.linspace(0.0, np.pi, 721)
    with style():
        figure = Figure(figsize=(WIDTH_IN, 3.4), layout="constrained")
        plane, space = figure.subplots(1, 2)
        plane.set(xlabel=f"x, {unit}", ylabel=f"y, {unit}")
        space.set(xlabel="θ, rad", ylabel=f"ρ, {unit}", xlim=(0, np.pi))
        plane.set_title("points in the plane", loc="left")
        space.set_title("their sinusoids in the parameter space", loc="left")
        for place, point in enumerate(points):
            colour = COLOURS[place % 6]
            rho = point[0] * np.cos(theta) + point[1] * np.sin(theta)
            space.plot(theta, rho, color=colour, lw=1.4)
            plane.plot(*point, "o", color=colour, ms=7, zorder=3)
        if len(points) >= 2:
            rho, angle = _nearest_line(points)
            space.plot(angle, rho, "o", mfc="none", mec=INK, ms=12, mew=1.4, zorder=4)
            text = f"ρ = {rho:.4g} {unit}\nθ = {angle:.3f} rad"
            # The label stands on the side of the space where there is room.
            left = angle > np.pi / 2
            offset, side = ((-14, -14), "right") if left else ((14, -14), "left")
            box = {"facecolor": "white", "alpha": 0.8, "edgecolor": "none", "pad": 1.0}
            space.annotate(
                text, (angle, rho), offset, textcoords="offset points", ha=side, va="top", bbox=box
            )
            normal = np.array([np.cos(angle), np.sin(angle)])
            along = np.array([-normal[1], normal[0]])
            low, high = np.sort(points @ along)[[0, -1]]
            over = 0.15 * (high - low)
            ends = rho * normal + np.outer([low - over, high + over], along)
            plane.plot(*ends.T, color=INK, lw=0.9, zorder=1)
        elif not len(points):
            say_empty(plane, "no points")
            say_empty(space, "no points")
        plane.set_aspect("equal", adjustable="datalim")
        plane.xaxis.set_major_locator(MaxNLocator(5))
        plane.yaxis.set_major_locator(MaxNLocator(5))
        space.set_xticks(np.pi * np.arange(5) / 4, ["0", "π/4", "π/2", "3π/4", "π"])
        dress(plane)
        dress(space)
        if title:
            figure.suptitle(title, x=0.01, ha="left", fontsize=10, fontweight="bold")
    return figure


def _nearest_line(points: np.ndarray) -> tuple[float, float]:
    """Return (ρ, θ) of the line with the least squared distances from points [P ≥ 2, 2]."""
    centre = points.mean(axis=0)
    normal = np.linalg.svd(points - centre)[2][1]
    theta = float(np.arctan2(normal[1], normal[0])) % np.pi
    return float(centre @ [np.cos(theta), np.sin(theta)]), theta
