"""Figures on disk, with what they show in words, for those who cannot see them."""

import pathlib
from typing import Any

from matplotlib.figure import Figure

_DPI = 150


def save(figure: Figure, path: pathlib.Path) -> None:
    """Write a figure as PNG, with its title and description inside.

    Args:
        figure: any.
        path: ends in .png.

    Example:
        >>> import tempfile
        >>> with tempfile.TemporaryDirectory() as folder:
        ...     save(Figure(), pathlib.Path(folder) / "empty.png")
        ...     (pathlib.Path(folder) / "empty.png").exists()
        True
    """
    title, *_ = [*_titles(figure), path.stem.replace("_", " ")]
    figure.savefig(
        path, dpi=_DPI, format="png", metadata={"Title": title, "Description": described(figure)}
    )


def described(figure: Figure) -> str:
    """Return what a figure shows, from its titles, axes and keys.

    Example:
        >>> figure = Figure()
        >>> axes = figure.subplots()
        >>> _ = axes.plot([0.0, 1.0], label="joint")
        >>> _ = axes.set(title="Errors", xlabel="time, s", ylabel="OSPA, m"), axes.legend()
        >>> described(figure)
        'Errors: OSPA, m over time, s. Shown: joint.'
    """
    top = figure.get_suptitle()
    bars = [axes for axes in figure.axes if axes.get_label() == "<colorbar>"]
    panels = [axes for axes in figure.axes if axes not in bars]
    ticks = lambda axes: " and ".join(filter(None, [axes.get_ylabel(), axes.get_xlabel()]))
    told = dict.fromkeys(": ".join(filter(None, [_title(p), _axes(p)])) for p in panels)
    parts = [top, *told]
    names = dict.fromkeys(
        text.get_text()
        for legend in [*figure.legends, *(axes.get_legend() for axes in figure.axes)]
        if legend is not None
        for text in legend.get_texts()
    )
    if names:
        parts.append(f"Shown: {', '.join(names)}")
    if bars:
        parts.append(f"Colours: {', '.join(dict.fromkeys(filter(None, map(ticks, bars))))}")
    known = [" ".join(part.split()).rstrip(".:") for part in parts if part.strip(" :")]
    return f"{'. '.join(known)}." if known else "Nothing."


def _titles(figure: Figure) -> list[str]:
    found = [figure.get_suptitle(), *map(_title, figure.axes)]
    return [" ".join(title.split()) for title in found if title]


def _title(axes: Any) -> str:
    return ", ".join(filter(None, (axes.get_title(loc=side) for side in ("left", "center"))))


def _axes(axes: Any) -> str:
    shown = [axes.get_ylabel(), axes.get_xlabel()] if axes.axison else []
    return " over ".join(filter(None, shown))
