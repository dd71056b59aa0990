"""Scenes that broke a tracker, on disk: what they are, and what was measured on them.

One JSON file, of plain numbers, so that a change of it can be read in a diff:

    {"format": "jaxtrack regression scenes 1",
     "about": which tracker, which family of scenes, which units beyond the names',
     "realizations": behind each mean,
     "ordinary": {score: {"mean": …, "standard_error": …}, …},
     "scenes": [{"params": {name: number or list, …}, "start": {…}, "loss": …,
                 "scores": {score: {"mean": …, "standard_error": …}, …}}, …]}     the worst first

A parameter's name is its path in the pytree, `fade.length_s` or `angle_rad`.
"""

import json
import os
import pathlib
from collections.abc import Callable
from typing import Any

import jax
import numpy as np

from jaxtrack.io import DataError
from jaxtrack.tuning.falsify import Falsified

_FORMAT = "jaxtrack regression scenes 1"


def write_regression_scenes(file: str | os.PathLike[str], found: Falsified, *, about: str) -> None:
    """Write what was found.

    Args:
        file: it is replaced.
        found: of `falsify`.
        about: for people: which tracker and which scenes, and how to make them again.

    Example:
        >>> import tempfile
        >>> one, none = {"gap_m": np.array([2.0])}, np.array([0.0])
        >>> found = Falsified(one, one, none, {"lost": none}, {"lost": none},
        ...                   {"lost": np.array(0.5)}, {"lost": np.array(0.1)}, 100)
        >>> with tempfile.TemporaryDirectory() as folder:
        ...     write_regression_scenes(f"{folder}/scenes.json", found, about="none")
        ...     again = read_regression_scenes(
        ...         f"{folder}/scenes.json", scene={"gap_m": 0.0}, score={"lost": 0.0})
        >>> print(again.scenes, again.ordinary)
        {'gap_m': array([2.])} {'lost': array(0.5)}
    """
    count = len(found.loss)
    at = lambda tree, n: jax.tree.map(lambda x: x[n], tree)
    content = {
        "format": _FORMAT,
        "about": about,
        "realizations": found.realizations,
        "ordinary": _means(found.ordinary, found.ordinary_error),
        "scenes": [
            {
                "params": _named(at(found.scenes, n)),
                "start": _named(at(found.start, n)),
                "loss": float(found.loss[n]),
                "scores": _means(at(found.score, n), at(found.score_error, n)),
            }
            for n in range(count)
        ],
    }
    text = json.dumps(content, indent=1, ensure_ascii=False)
    pathlib.Path(file).write_text(text + "\n", encoding="utf-8")


def read_regression_scenes(file: str | os.PathLike[str], *, scene: Any, score: Any) -> Falsified:
    """Return what stands in a file.

    Args:
        file: of `write_regression_scenes`.
        scene: any scene of the family, for the structure of its parameters.
        score: any score, for its structure.

    Raises:
        DataError: not such a file, another format, or other names than those asked for.

    Example:
        >>> import tempfile
        >>> with tempfile.TemporaryDirectory() as folder:
        ...     file = pathlib.Path(folder) / "scenes.json"
        ...     _ = file.write_text('{"format": "another"}')
        ...     read_regression_scenes(file, scene={"gap_m": 0.0}, score={"lost": 0.0})
        Traceback (most recent call last):
        jaxtrack.io.errors.DataError: ...scenes.json: want a file whose format is 'jaxtrack regression scenes 1'
    """  # noqa: E501
    try:
        content = json.loads(pathlib.Path(file).read_text(encoding="utf-8"))
    except (json.JSONDecodeError, UnicodeDecodeError) as error:
        raise DataError(f"{file}: want JSON: {error}") from error
    if not isinstance(content, dict) or content.get("format") != _FORMAT:
        raise DataError(f"{file}: want a file whose format is {_FORMAT!r}")
    try:
        return _falsified(content, scene, score, file)
    except KeyError as error:
        raise DataError(f"{file}: {error} is missing") from error


def _falsified(content: Any, scene: Any, score: Any, file: str | os.PathLike[str]) -> Falsified:
    rows = content["scenes"]
    if not rows:
        raise DataError(f"{file}: scenes: got none, want at least one")

    def table(like: Any, of: Callable[[Any], Any]) -> Any:
        each = [_filled(like, of(row), file) for row in rows]
        return jax.tree.map(lambda *x: np.stack(x), *each)

    part = lambda scores, which: {name: value[which] for name, value in scores.items()}
    return Falsified(
        scenes=table(scene, lambda row: row["params"]),
        start=table(scene, lambda row: row["start"]),
        loss=np.array([row["loss"] for row in rows]),
        score=table(score, lambda row: part(row["scores"], "mean")),
        score_error=table(score, lambda row: part(row["scores"], "standard_error")),
        ordinary=_filled(score, part(content["ordinary"], "mean"), file),
        ordinary_error=_filled(score, part(content["ordinary"], "standard_error"), file),
        realizations=content["realizations"],
    )


def _name(path: Any) -> str:
    return jax.tree_util.keystr(path, simple=True, separator=".")


def _named(tree: Any) -> dict[str, Any]:
    """Return the leaves by name, as JSON takes them."""
    return {
        _name(path): np.asarray(leaf).tolist() for path, leaf in jax.tree.leaves_with_path(tree)
    }


def _means(mean: Any, error: Any) -> dict[str, Any]:
    errors = _named(error)
    return {
        name: {"mean": value, "standard_error": errors[name]}
        for name, value in _named(mean).items()
    }


def _filled(like: Any, values: dict[str, Any], file: str | os.PathLike[str]) -> Any:
    """Return the structure of `like` with the values of these names."""
    paths, structure = jax.tree.flatten_with_path(like)
    names = [_name(path) for path, _ in paths]
    if set(names) != set(values):
        raise DataError(f"{file}: got the names {sorted(values)}, want {sorted(names)}")
    return structure.unflatten([np.asarray(values[name], np.float64) for name in names])
