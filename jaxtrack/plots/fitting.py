"""How a fit went: losses and parameters step by step, and the way over a map of the loss."""

from collections.abc import Mapping
from typing import Any, Protocol

import jax
import matplotlib
import numpy as np
from matplotlib.axes import Axes
from matplotlib.colors import ListedColormap
from matplotlib.figure import Figure

from jaxtrack.plots.style import COLOURS, INK, MARKERS, WIDTH_IN, dress, say_empty, style


class Fitted(Protocol):
    """What is drawn of a `tuning.FitResult`: the layers forbid its name here, not its form."""

    best_step: Any
    history: Any


def fit_history(result: Fitted, *, title: str = "") -> Figure:
    """Return losses and parameters against the steps of a fit, a panel each.

    Batch losses are pale, for each is of other realizations; held-out ones have their standard
    errors. A parameter that stays positive is on a logarithmic scale; one with several entries
    has a line for each. A dotted line marks the step whose parameters were kept.

    Args:
        result: of `tuning.fit`.
        title: of the figure.

    Example:
        >>> import optax
        >>> from jaxtrack.tuning import fit
        >>> loss = lambda x, key: (x - jax.random.normal(key)) ** 2
        >>> result = fit(loss, 4.0, optax.sgd(0.1), key=jax.random.key(0), steps=5, batch=4, holdout=8)
        >>> [axes.get_ylabel() for axes in fit_history(result).axes]
        ['loss', 'parameter']
    """  # noqa: E501
    history = result.history
    params = jax.tree.leaves_with_path(history.params)
    steps = len(history.loss)
    with style():
        figure = Figure(figsize=(WIDTH_IN, 2.6 + 1.5 * len(params)), layout="constrained")
        panels: Any = np.ravel(
            figure.subplots(
                1 + len(params), 1, sharex=True, height_ratios=[1.6, *(1.0 for _ in params)]
            )
        )
        top = panels[0]
        top.plot(np.arange(steps), history.loss, color=COLOURS[5], lw=0.8, label="batch")
        top.errorbar(
            history.evaluated,
            history.held_out,
            yerr=history.held_out_error,
            color=COLOURS[0],
            marker=MARKERS[0],
            ms=4,
            lw=1.2,
            capsize=2,
            label="held out, ± standard error",
        )
        top.set_ylabel("loss")
        for axes, (path, values) in zip(panels[1:], params, strict=True):
            values = np.asarray(values, np.float64).reshape(steps + 1, -1)
            for place, line in enumerate(values.T):
                axes.plot(np.arange(steps + 1), line, color=COLOURS[place % len(COLOURS)])
            if (values > 0).all():
                _logarithmic(axes, "y", values)
            axes.set_ylabel(jax.tree_util.keystr(path, simple=True, separator=".") or "parameter")
        for axes in panels:
            axes.axvline(result.best_step, color=INK, lw=0.9, ls=(0, (1, 2)))
            dress(axes)
        panels[-1].set_xlabel("step")
        figure.align_ylabels(list(panels))
        figure.suptitle(title, x=0.01, ha="left", fontsize=10, fontweight="bold")
        handles, labels = top.get_legend_handles_labels()
        figure.legend(handles, labels, loc="outside lower center", ncols=2)
    return figure


def loss_map(
    x: Any,
    y: Any,
    loss: Any,
    paths: Mapping[str, Any],
    *,
    x_label: str,
    y_label: str,
    points: Mapping[str, tuple[float, float]] | None = None,
    title: str = "",
) -> Figure:
    """Return the loss over two parameters from above, with the optimizer's ways on it.

    Args:
        x: [X] ascending values of the first parameter.
        y: [Y] of the second. Positive axes are logarithmic.
        loss: [X, Y].
        paths: [S, 2] parameters step by step, of each start; a hollow mark where it begins, a full
            one where it ends.
        x_label: the first parameter and its unit.
        y_label: the second.
        points: single settings to compare with.
        title: of the figure.

    Example:
        >>> x = np.array([1.0, 2.0, 4.0])
        >>> figure = loss_map(x, x, np.eye(3), {"fit": [[1, 1], [2, 3]]}, x_label="a", y_label="b")
        >>> figure.axes[0].get_xscale()
        'log'
    """
    x, y, loss = (np.asarray(value, np.float64) for value in (x, y, loss))
    with style():
        figure = Figure(figsize=(WIDTH_IN, 5.0), layout="constrained")
        axes = figure.add_subplot()
        if loss.size and np.isfinite(loss).any():
            levels = np.linspace(np.nanmin(loss), np.nanmax(loss), 25)
            levels = levels if levels[-1] > levels[0] else levels[0] + np.arange(2.0)
            # From white at the least loss to a grey that lines are still seen on.
            greys = ListedColormap(matplotlib.colormaps["Greys"](np.linspace(0.0, 0.6, 24)))
            filled = axes.contourf(x, y, loss.T, levels, cmap=greys)
            bar = figure.colorbar(filled, ax=axes, shrink=0.8, aspect=30, pad=0.02, format="%.2g")
            bar.set_label("mean loss")
            bar.outline.set_visible(False)  # type: ignore[operator]
        else:
            say_empty(axes, "no losses")
        for place, (name, path) in enumerate(paths.items()):
            way = np.asarray(path, np.float64).reshape(-1, 2)
            colour, marker = COLOURS[place % len(COLOURS)], MARKERS[place % len(MARKERS)]
            axes.plot(*way.T, color=colour, lw=1.3)
            axes.plot([], [], color=colour, marker=marker, ms=6, lw=1.3, label=name)
            for end, face, edge in ((way[:1], "white", colour), (way[-1:], colour, "white")):
                axes.plot(
                    *end.T,
                    color=colour,
                    marker=marker,
                    ms=8,
                    mfc=face,
                    mec=edge,
                    mew=1.4,
                    ls="none",
                )
        for place, (name, point) in enumerate((points or {}).items()):
            axes.plot(*point, marker="xP+*"[place % 4], ms=9, mew=1.8, ls="none", label=name,
                      color=COLOURS[(len(paths) + place) % len(COLOURS)])  # fmt: skip
        for side, values in (("x", x), ("y", y)):
            if len(values) and (values > 0).all():
                _logarithmic(axes, side, values)
        axes.set(xlabel=x_label, ylabel=y_label)
        axes.set_title(title, loc="left", fontweight="bold")
        dress(axes)
        axes.grid(False)
        handles, labels = axes.get_legend_handles_labels()
        if handles:
            figure.legend(handles, labels, loc="outside lower center", ncols=min(len(handles), 5))
    return figure


def _logarithmic(axes: Axes, side: str, values: np.ndarray) -> None:
    """Make an axis logarithmic; over less than a factor of three plain ticks say more."""
    if values.max() > 3 * values.min():
        getattr(axes, f"set_{side}scale")("log")
