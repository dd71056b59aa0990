"""An animation of a tracker at work: the looks as they come, and what it makes of them."""

from typing import Any

import numpy as np
from matplotlib.animation import FuncAnimation
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure

from jaxtrack.plots.style import COLOURS, INK, dress, style
from jaxtrack.types import Scan, Stage, Tracks, Truth

_MARGIN_M = 1.0
_TAIL = 20  # looks of detections and of tracks that are still shown


def film(
    scans: Scan, truth: Truth, tracks: Tracks, *, every: int = 1, title: str = ""
) -> FuncAnimation:
    """Return an animation; in a notebook show `HTML(film(...).to_jshtml())`.

    Args:
        scans: T looks stacked.
        truth: at the same looks, x north.
        tracks: tables stacked [T]; tentative tracks are thin.
        every: so many looks a frame.
        title: of the figure.

    Example:
        >>> scans = Scan(np.arange(2.0), np.ones(2, bool), np.ones((2, 1, 2)), np.ones((2, 1), bool))
        >>> truth = Truth(np.arange(2.0), np.ones((2, 1, 4)), np.ones((2, 1), bool))
        >>> one = np.ones((2, 1))
        >>> tracks = Tracks(np.arange(2.0), np.ones((2, 1, 4)), np.ones((2, 1, 4, 4)), one > 0,
        ...                 np.zeros((2, 1), int), 2 * one.astype(int), one, one)
        >>> "<img" in film(scans, truth, tracks).to_jshtml()
        True
    """  # noqa: E501
    host = [np.asarray(x) for x in (scans.position_m, scans.mask, tracks.mean, tracks.mask)]
    place, seen, mean, live = host
    seen = seen & np.asarray(scans.valid)[:, None]
    stage, identity = np.asarray(tracks.stage), np.asarray(tracks.identity)
    state, there = np.asarray(truth.state), np.asarray(truth.mask)
    everything = np.concatenate([place[seen], state[there][:, :2], mean[live][:, :2]])
    if not len(everything):
        everything = np.zeros((1, 2))
    with style():
        figure = Figure(figsize=(5.2, 5.2), layout="constrained")
        FigureCanvasAgg(figure)
        axes = figure.add_subplot()
    low, high = everything.min(0) - _MARGIN_M, everything.max(0) + _MARGIN_M

    def draw(look: int) -> list[Any]:
        with style():
            axes.clear()
            first = max(look - _TAIL, 0)
            for k in range(first, look + 1):
                faint = 0.15 + 0.85 * (k - first + 1) / (look - first + 1)
                north, east = place[k][seen[k]].T
                axes.plot(east, north, ".", color="#999999", ms=4, alpha=faint)
            for target in np.flatnonzero(there[look]):
                north, east = state[look, target, :2]
                axes.plot(east, north, "o", mfc="none", mec=INK, ms=11)
            for slot in np.flatnonzero(live[look]):
                same = (identity[first : look + 1] == identity[look, slot]) & live[first : look + 1]
                north, east = mean[first : look + 1][same][:, :2].T
                sure = stage[look, slot] >= Stage.CONFIRMED
                colour = COLOURS[identity[look, slot] % len(COLOURS)]
                axes.plot(east, north, color=colour, lw=2.2 if sure else 0.7)
            axes.set(xlim=(low[1], high[1]), ylim=(low[0], high[0]), xlabel="east, m")
            axes.set_ylabel("north, m")
            axes.set_aspect("equal")
            axes.set_title(f"{title}  {float(scans.time_s[look]):.1f} s", loc="left")
            dress(axes)
        return []

    frames = range(0, len(seen), every)
    return FuncAnimation(figure, draw, frames=frames, interval=100, blit=False)
