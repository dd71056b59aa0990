"""Where a sonar looks: the earth's frame, its carrier's, and what range and bearing are."""

from typing import Any

import jax
import numpy as np
from matplotlib.figure import Figure

from jaxtrack.models import BeamSonar
from jaxtrack.models.frames import earth_to_polar, polar_to_earth
from jaxtrack.plots.style import COLOURS, FAINT, INK, dress, style
from jaxtrack.types import Pose

_BEAMS_BETWEEN_LINES = 10


def sonar_frames(
    pose: Pose, sonar: BeamSonar, target_m: Any, *, beams: int = 90, title: str = ""
) -> Figure:
    """Return a map of a carrier with its axes, its sonar's sector, and a target's range and bearing.

    Args:
        pose: of the carrier, position_m [2] and heading_rad [].
        sonar: scope, sector and mount are drawn.
        target_m: [2] north and east, an array.
        beams: of the sector; every tenth edge is drawn.
        title: of the figure.

    Example:
        >>> figure = sonar_frames(Pose(np.zeros(2), np.array(0.5)), BeamSonar(), np.ones(2))
        >>> figure.axes[0].get_xlabel()
        'east, m'

    Source: clustering-statistic Hough transform (2018), figure 3.
    """  # noqa: E501
    scope, half = float(sonar.range_max_m), float(sonar.sector_rad) / 2
    heading = float(pose.heading_rad)
    pose, target = jax.tree.map(lambda x: np.asarray(x, np.float32), (pose, target_m))
    cast: Any = lambda x: np.asarray(x, target.dtype)
    to_earth: Any = lambda r, a: np.asarray(polar_to_earth(cast(r), cast(a), pose, sonar.mount_m))[
        ..., ::-1
    ]
    range_m, bearing = (float(x) for x in earth_to_polar(target, pose, sonar.mount_m))
    sensor = to_earth(0.0, 0.0)
    with style():
        figure = Figure(figsize=(5.4, 5.0), layout="constrained")
        plane = figure.add_subplot()
        for edge in np.arange(0, beams + 1, _BEAMS_BETWEEN_LINES) / beams * 2 * half - half:
            plane.plot(*to_earth([0.0, scope], [edge] * 2).T, color=FAINT, lw=0.8, zorder=1)
        rim = np.linspace(-half, half, 100)
        outline = np.concatenate([sensor[None], to_earth(scope + 0 * rim, rim), sensor[None]])
        plane.plot(*outline.T, color=COLOURS[0], lw=1.2, zorder=2, label="sector and scope")
        north: Any = sensor + np.array([0.0, 0.55 * scope])
        plane.plot(*np.stack([sensor, north]).T, color=INK, lw=0.9, ls=(0, (4, 2)))
        plane.annotate("north", north, (0, 3), textcoords="offset points", ha="center")
        for angle, word in ((0.0, "ahead"), (np.pi / 2, "starboard")):
            tip = to_earth(0.32 * scope, angle)
            arrow = {"arrowstyle": "-|>", "color": COLOURS[1], "lw": 1.6, "shrinkA": 0}
            plane.plot(*tip, alpha=0.0)  # annotations alone would not widen the axes
            plane.annotate("", tip, sensor, arrowprops=arrow, zorder=4)
            plane.annotate(word, tip, (0, 4), textcoords="offset points", color=COLOURS[1])
        look = {"color": COLOURS[2], "lw": 1.4}
        plane.plot(*np.stack([sensor, target[::-1]]).T, zorder=3, **look)
        plane.plot(*target[::-1], "o", color=COLOURS[2], ms=7, zorder=4, label="target")
        plane.annotate(f"ρ = {range_m:.0f} m", to_earth(0.7 * range_m, bearing), (5, -9),
                       textcoords="offset points", color=COLOURS[2])  # fmt: skip
        turn = np.degrees(heading)
        for at, start, end, text, colour in (
            (0.45, -heading, 0.0, f"ψ = {turn:.0f}°", INK),
            (0.22, 0.0, bearing, f"α = {np.degrees(bearing):.0f}°", COLOURS[2]),
        ):
            arc = np.linspace(start, end, 40)
            plane.plot(*to_earth(at * scope + 0 * arc, arc).T, color=colour, lw=0.9, zorder=3)
            middle = to_earth((at + 0.1) * scope, 0.4 * start + 0.6 * end)
            plane.annotate(text, middle, color=colour, ha="center", va="center", zorder=5)
        plane.plot(*sensor, "^", color=INK, ms=8, zorder=5, label="sonar")
        plane.set(xlabel="east, m", ylabel="north, m", aspect="equal")
        plane.margins(0.08)
        plane.set_title(title, loc="left", fontweight="bold")
        dress(plane)
        plane.grid(False)
        handles, labels = plane.get_legend_handles_labels()
        figure.legend(handles, labels, loc="outside lower center", ncols=len(handles))
    return figure
