"""A study as data: a TOML file says which scenes, methods, metrics and how many trials.

    seed = 0
    trials = 1000

    [scene]
    function = "my_scenes:noisy_points"
    sigma_m = { grid = [1.0, 2.0, 4.0] }

    [method.mean]
    function = "my_scenes:mean"

    [metric.error_m]
    function = "my_scenes:error"

What results are compared with stands there too, in tables `[[compare]]`; it decides no result. Here
a file is read, checked and tied to its functions; nothing is computed.
"""

import inspect
import math
import pathlib
import re
import tomllib
from collections.abc import Callable, Mapping
from typing import Any, NamedTuple, NoReturn

from jaxtrack.studies.comparisons import Comparison, read_comparisons
from jaxtrack.studies.functions import find_function, forget_others
from jaxtrack.studies.study_file import StudyError, StudyFile

_NAME = re.compile(r"[A-Za-z_][A-Za-z0-9_-]*")
_MOST_TRIALS = 2**32
_DEFAULTS = {"seed": 0, "chunk": 256, "micro_batch": 32}
_TOP = ("seed", "trials", "chunk", "micro_batch", "until", "scene", "method", "metric", "compare")
# What a function is given beside its fields.
_GIVEN = {"scene": ("key",), "method": ("scene",), "metric": ("scene", "estimate")}


class Part(NamedTuple):
    """The scene, a method or a metric: a function and what it is called with."""

    where: str  # its table in the file: "scene", "method.mean"
    name: str  # "scene", "mean"
    function: str  # as the file names it
    call: Callable[..., Any]
    fields: dict[str, Any]  # those of one value
    grid: dict[str, tuple[Any, ...]]  # those of several
    static: frozenset[str]  # known to Python; the others are traced


class Until(NamedTuple):
    """When a study may stop: all standard errors of a metric are this small."""

    metric: str
    se: float


class Design(NamedTuple):
    """A study, checked and ready to run."""

    scene: Part
    methods: tuple[Part, ...]
    metrics: tuple[Part, ...]
    seed: int
    trials: int  # at most, with `until`
    chunk: int  # trials between two visits to the disk
    micro_batch: int
    until: Until | None
    compare: tuple[Comparison, ...]
    config: dict[str, Any]  # the file's tables that decide results, defaults filled in
    file: StudyFile
    folder: pathlib.Path  # where it lies; its own functions are looked for here


def read_design(file: pathlib.Path) -> Design:
    """Read a study's file.

    Raises:
        StudyError: what is wrong, with line and key.
        OSError: there is no such file.

    Example:
        >>> from jaxtrack.studies.functions import shipped_study
        >>> design = read_design(shipped_study("crossing"))
        >>> [method.name for method in design.methods]
        ['improved', 'joint']
    """
    try:
        text = file.read_text(encoding="utf-8")
    except UnicodeDecodeError as error:
        raise StudyError(f"{file}: is not text in UTF-8") from error
    return design_of(text, file.parent, str(file))


def design_of(
    text: str, folder: pathlib.Path, name: str = "study", *, functions: bool = True
) -> Design:
    r"""Return the study that a text describes.

    Args:
        text: TOML.
        folder: where its own functions are looked for.
        name: of the file, for messages.
        functions: look for them; a study without can be shown, not run.

    Raises:
        StudyError: what is wrong, with line and key.

    Example:
        >>> design_of("trials = 10\ntrails = 20", pathlib.Path())  # doctest: +ELLIPSIS
        Traceback (most recent call last):
        jaxtrack.studies.study_file.StudyError: study:2: trails: unknown key, want one of seed, ...
    """
    try:
        tables = tomllib.loads(text)
    except tomllib.TOMLDecodeError as error:
        raise StudyError(f"{name}: {error}") from error
    file, folder = StudyFile(name, text), folder.resolve()
    for key in tables:
        if key not in _TOP:
            file.fail((key,), f"unknown key, want one of {', '.join(_TOP)}")
    for key in ("trials", "scene", "method", "metric"):
        if key not in tables:
            file.fail((key,), "is missing")
    compare = tables.pop("compare", [])
    config = {**_DEFAULTS, **tables}
    _whole(file, config, "seed", 0, 2**31 - 1)
    _whole(file, config, "trials", 1, _MOST_TRIALS)
    _whole(file, config, "micro_batch", 1, _MOST_TRIALS)
    _whole(file, config, "chunk", 1, _MOST_TRIALS)
    if config["chunk"] % config["micro_batch"]:
        at = "chunk" if "chunk" in tables else "micro_batch"
        want = f"chunk ({config['chunk']}) a multiple of micro_batch ({config['micro_batch']})"
        file.fail((at,), f"got {config[at]}, want {want}")

    where = folder if functions else None
    if functions:
        forget_others(folder)
    scene = _part(file, config["scene"], ("scene",), where)
    methods, metrics = (
        tuple(
            _part(file, table, (kind, name), where)
            for name, table in _table(file, config[kind], (kind,)).items()
        )
        for kind in ("method", "metric")
    )
    for metric in metrics:
        for field in metric.grid:
            wish = "want one value; a metric of another name may have another"
            file.fail(("metric", metric.name, field), f"got a grid, {wish}")
        for method in methods:
            if metric.name in method.grid:
                at = ("method", method.name, metric.name)
                file.fail(at, "got a grid, but a metric has this name")
    if "trial" in scene.grid:
        file.fail(("scene", "trial"), "got a grid, but this is the name of the trials' dimension")
    until = _until(file, config, [metric.name for metric in metrics])
    axes = {method.name: _axes(scene, method) for method in methods}
    return Design(
        scene=scene,
        methods=methods,
        metrics=metrics,
        seed=config["seed"],
        trials=config["trials"],
        chunk=config["chunk"],
        micro_batch=config["micro_batch"],
        until=until,
        compare=read_comparisons(file, compare, axes, [metric.name for metric in metrics]),
        config=config,
        file=file,
        folder=folder,
    )


def axes_of(design: Design, method: Part) -> dict[str, tuple[Any, ...]]:
    """Return the grid that a method is run on: the values along each dimension, by its name.

    Example:
        >>> from jaxtrack.studies.functions import shipped_study
        >>> design = read_design(shipped_study("crossing"))
        >>> list(axes_of(design, design.methods[1]))
        ['sigma_m', 'joint.gate']
    """
    return _axes(design.scene, method)


def _axes(scene: Part, method: Part) -> dict[str, tuple[Any, ...]]:
    own = {f"{method.name}.{field}": values for field, values in method.grid.items()}
    return {**scene.grid, **own}


def _table(file: StudyFile, value: Any, path: tuple[str, ...]) -> dict[str, Any]:
    if not isinstance(value, dict) or not value:
        file.fail(path, f"got {value!r}, want a table with at least one entry")
    return value


def _whole(file: StudyFile, config: Mapping[str, Any], key: str, least: int, most: int) -> None:
    value = config[key]
    if type(value) is not int or not least <= value <= most:
        file.fail((key,), f"got {value!r}, want a whole number from {least} to {most}")


def _until(file: StudyFile, config: Mapping[str, Any], metrics: list[str]) -> Until | None:
    if "until" not in config:
        return None
    table = _table(file, config["until"], ("until",))
    if set(table) != {"metric", "se"}:
        file.fail(("until",), f"got {', '.join(table)}, want metric and se")
    if table["metric"] not in metrics:
        file.fail(("until", "metric"), f"got {table['metric']!r}, want one of {', '.join(metrics)}")
    se = table["se"]
    if type(se) not in (int, float) or not 0 < se < math.inf:
        file.fail(("until", "se"), f"got {se!r}, want a positive number")
    return Until(table["metric"], float(se))


def _part(file: StudyFile, table: Any, path: tuple[str, ...], folder: pathlib.Path | None) -> Part:
    table = _table(file, table, path)
    kind, name = path[0], path[-1]
    if not _NAME.fullmatch(name):
        file.fail(path, "want a name of letters, digits, _ and -, with no digit in front")
    if not isinstance(table.get("function"), str):
        file.fail((*path, "function"), f"got {table.get('function')!r}, want text")
    try:
        call = _absent if folder is None else find_function(kind, table["function"], folder)
    except (ValueError, ImportError) as error:
        file.fail((*path, "function"), str(error))
    values = {key: value for key, value in table.items() if key not in ("function", "static")}
    static = table.get("static", [])
    if not isinstance(static, list) or not all(key in values for key in static):
        file.fail((*path, "static"), f"got {static!r}, want a list of names of fields")
    fields: dict[str, Any] = {}
    grid: dict[str, tuple[Any, ...]] = {}
    for key, value in values.items():
        if not _NAME.fullmatch(key):
            file.fail(
                (*path, key), "want a name of letters, digits, _ and -, with no digit in front"
            )
        if isinstance(value, dict):
            grid[key] = _grid(file, value, (*path, key))
        else:
            fields[key] = _value(file, value, (*path, key))
    _check_call(file, call, values, path)
    words = {key for key in values if isinstance(grid.get(key, (fields.get(key),))[0], (bool, str))}
    return Part(
        ".".join(path), name, table["function"], call, fields, grid, frozenset(words | set(static))
    )


def _absent(*given: Any, **fields: Any) -> NoReturn:
    raise StudyError("the study was read without its functions")


def _value(file: StudyFile, value: Any, path: tuple[str, ...]) -> Any:
    """Return a field's value; of lists a tuple."""
    if isinstance(value, list) and value:
        if any(isinstance(entry, (bool, str)) for entry in value):
            file.fail(path, f"got {value!r}, want numbers in a list")
        return tuple(_value(file, entry, path) for entry in value)
    if isinstance(value, (bool, str)):
        return value
    if not isinstance(value, (int, float)) or math.isnan(value):
        file.fail(path, f"got {value!r}, want a number, text, true, false, or numbers in a list")
    return value


def _grid(file: StudyFile, table: dict[str, Any], path: tuple[str, ...]) -> tuple[Any, ...]:
    values = table.get("grid")
    if set(table) != {"grid"} or not isinstance(values, list) or not values:
        file.fail(path, f"got {table!r}, want {{ grid = [value, …] }}")
    kinds = {type(value) for value in values}
    alike = kinds <= {int, float} or kinds in ({str}, {bool})
    if not alike or len(set(values)) < len(values):
        file.fail(path, f"got {values!r}, want different values of one kind: numbers, text or bool")
    return tuple(_value(file, value, path) for value in values)


def _check_call(
    file: StudyFile, call: Callable[..., Any], values: Mapping[str, Any], path: tuple[str, ...]
) -> None:
    """Check that a function takes the fields that it will be given."""
    try:
        signature = inspect.signature(call)
    except (TypeError, ValueError):  # some builtins have none
        return
    given = _GIVEN[path[0]]
    parameters = signature.parameters.values()
    if not any(parameter.kind is parameter.VAR_KEYWORD for parameter in parameters):
        for key in values:
            taken = signature.parameters.get(key)
            if taken is None or taken.kind is taken.POSITIONAL_ONLY:
                takes = f"{call.__name__}{signature}"
                file.fail((*path, key), f"unknown field; the function is {takes}")
    try:
        signature.bind(*given, **values)
    except TypeError as error:
        wants = f"({', '.join(given)}, **fields)"
        file.fail(path, f"{error}; the function is called with {wants}")
