"""One look for all figures: type, lines, and colours that the colour-blind tell apart."""

from collections.abc import Iterable
from contextlib import AbstractContextManager

import matplotlib
from matplotlib.axes import Axes

# Okabe and Ito's palette, from the most to the least contrast against white.
COLOURS = ("#0072B2", "#D55E00", "#009E73", "#CC79A7", "#E69F00", "#56B4E9", "#000000")
MARKERS = ("o", "s", "^", "D", "v", "P", "X")
INK = "#333333"
FAINT = "#DDDDDD"
WIDTH_IN = 7.2  # a page's width; at 150 dots an inch 1080 pixels

# A method looks the same in every figure.
_METHODS = ("standard", "modified", "improved", "neutrosophic", "joint")
_METHOD_LOOKS = dict(zip(_METHODS, (6, 3, 4, 0, 1), strict=True))


def style() -> AbstractContextManager[None]:
    """Return the context in which figures get the one look.

    Example:
        >>> with style():
        ...     print(matplotlib.rcParams["figure.dpi"])
        150.0
    """
    return matplotlib.rc_context(
        {
            "figure.dpi": 150,
            "font.family": "DejaVu Sans",
            "font.size": 9,
            "axes.titlesize": 10,
            "axes.labelsize": 9,
            "axes.labelcolor": INK,
            "axes.edgecolor": INK,
            "axes.linewidth": 0.7,
            "axes.spines.top": False,
            "axes.spines.right": False,
            "axes.formatter.useoffset": False,
            "axes.axisbelow": True,
            "text.color": INK,
            "xtick.color": INK,
            "ytick.color": INK,
            "grid.color": FAINT,
            "grid.linewidth": 0.6,
            "legend.frameon": False,
            "legend.fontsize": 8.5,
            "lines.linewidth": 1.6,
        }
    )


def looks_of(methods: Iterable[str]) -> dict[str, tuple[str, str]]:
    """Return each method's colour and marker; names that are not known get what is left.

    Example:
        >>> looks_of(["joint", "mine"])
        {'joint': ('#D55E00', 's'), 'mine': ('#0072B2', 'o')}
    """
    methods = list(methods)
    taken = [_METHOD_LOOKS[name] for name in methods if name in _METHOD_LOOKS]
    free = iter([k for k in range(len(COLOURS)) if k not in taken] + list(range(len(methods))))
    index = {name: _METHOD_LOOKS[name] if name in _METHOD_LOOKS else next(free) for name in methods}
    return {name: (COLOURS[k % 7], MARKERS[k % 7]) for name, k in index.items()}


def dress(axes: Axes, *, grid: str = "both") -> None:
    """Give axes what a style context would only lend them: ticks are made when they are drawn."""
    axes.tick_params(labelsize=8.5, width=0.7, length=3, color=INK, labelcolor=INK)
    axes.grid(True, axis=grid, color=FAINT, linewidth=0.6)  # type: ignore[arg-type]


def say_empty(axes: Axes, what: str) -> None:
    """Say in the middle of axes that there is nothing to draw."""
    axes.text(0.5, 0.5, what, transform=axes.transAxes, ha="center", va="center", color="#777777")
