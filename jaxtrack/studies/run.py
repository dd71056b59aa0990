"""Runs a study: chunks of trials through `monte_carlo`, onto the disk, until there are enough.

Trial t has the key fold_in(key(seed), t) in every cell and with every method, so methods are
compared on the same draws. A method is one program; its cells differ in traced values, but for
those of static fields. A chunk that is stored is read, not computed, so a study that was stopped
goes on where it was and ends in the same bytes.
"""

import itertools
import pathlib
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from jaxtrack.montecarlo import monte_carlo
from jaxtrack.studies import chunks, made, summary
from jaxtrack.studies.design import Design, Part, StudyError, design_of
from jaxtrack.types import Array, Key


class Progress(NamedTuple):
    """How far a study is."""

    done: float  # trials of every cell
    total: float  # that there will be; with `until`, as the errors so far let expect
    rate: float  # trials a second, this session
    last: tuple[str, float, float] | None  # variable, mean, standard error: the widest


class Outcome(NamedTuple):
    """Where a study stands."""

    design: Design
    store: chunks.Chunks
    found: summary.Moments | None  # of the trials that count: whole chunks from the first on
    complete: bool
    damaged: tuple[int, ...]  # chunks with a record that does not fit


class _Program(NamedTuple):
    """What one compiled program computes of a method."""

    method: Part
    trial: Callable[[Key, Any], dict[str, Array]]
    params: Any  # leaves [P, …]
    cells: list[int]  # [P] of the method's


def run_study(
    design: Design,
    folder: pathlib.Path,
    *,
    on_progress: Callable[[Progress], None] = lambda _: None,
    stopped: Callable[[], bool] = lambda: False,
) -> Outcome:
    """Run a study, or go on with it, and return where it then stands.

    Args:
        design: of the study.
        folder: for its results; one that holds them already must be of the same study.
        on_progress: called now and then.
        stopped: asked after each chunk whether that was the last for now.

    Raises:
        StudyError: a function does not fit, the folder is of another study, or the disk fails.

    Example:
        >>> import tempfile
        >>> text = '''
        ... trials = 64
        ... chunk = 32
        ... [scene]
        ... function = "jax.random:normal"
        ... shape = [4]
        ... static = ["shape"]
        ... [method.mean]
        ... function = "jax.numpy:mean"
        ... [metric.larger]
        ... function = "jax.numpy:less"
        ... '''
        >>> text = text.replace("jax.numpy:less", "operator:lt").replace("[4]", "[]")
    """
    programs = [p for method in design.methods for p in _programs(design, method)]
    variables = _variables(design, programs)
    store = _open(design, folder, variables)
    chunks.check_writable(store)
    chunks.clean(store)
    dims = {name: variable.dims for name, variable in variables.items()}
    metric = design.until.metric if design.until else design.metrics[0].name
    clock, computed = time.perf_counter(), 0.0
    found: summary.Moments | None = None

    for number in range(store.count):
        first, end = store.span(number)
        values = chunks.read(store, number)
        if values is None:

            def report(share: float, first: int = first, end: int = end) -> None:
                new = share * (end - first)
                rate = (computed + new) / (time.perf_counter() - clock)
                last = None if found is None else summary.widest(design, found, metric)
                on_progress(Progress(first + new, _total(design, found, last), rate, last))

            values = _compute(design, programs, variables, first, end, report)
            chunks.write(store, number, values)
            computed += end - first
        found = summary.merged(found, summary.moments(design, dims, values))
        if summary.enough(design, found):
            break
        if stopped():
            break
    return _outcome(design, store, found, ())


def open_study(folder: pathlib.Path) -> Design:
    """Return the design of the study in a folder.

    Raises:
        StudyError: there is none, or its functions are gone.
    """
    attributes = chunks.open_chunks(folder).attributes
    return design_of(attributes["text"], pathlib.Path(attributes["folder"]), f"{folder}'s study")


def status_of(folder: pathlib.Path) -> Outcome:
    """Return where the study in a folder stands; computes nothing, writes nothing.

    Raises:
        StudyError: there is none, or it cannot be read.
    """
    design, store = open_study(folder), chunks.open_chunks(folder)
    dims = {name: tuple(array.metadata.dimension_names[:-1]) for name, array in store.arrays.items()}
    found: summary.Moments | None = None
    records = sorted(chunks.committed(store))
    damaged = []
    for place, number in enumerate(records):
        values = chunks.read(store, number)
        if values is None:
            damaged.append(number)
        elif place == number and not damaged:
            found = summary.merged(found, summary.moments(design, dims, values))
    return _outcome(design, store, found, tuple(damaged))


def _outcome(
    design: Design,
    store: chunks.Chunks,
    found: summary.Moments | None,
    damaged: tuple[int, ...],
) -> Outcome:
    complete = found is not None and (
        found.trials == design.trials or summary.enough(design, found)
    )
    return Outcome(design, store, found, complete, damaged)


def _open(
    design: Design, folder: pathlib.Path, variables: dict[str, chunks.Variable]
) -> chunks.Chunks:
    """Return the folder's store, a new one if there is none; refuse another study's."""
    facts = {"study": design.config, "made_with": made.decisive(design)}
    if not (folder / chunks.RESULTS).exists():
        attributes = {
            **facts,
            "labels": summary.labels_of(design),
            "text": design.text,
            "folder": str(design.folder),
            "about": made.about(design),
        }
        return chunks.create(
            folder, variables, trials=design.trials, chunk=design.chunk, attributes=attributes
        )
    store = chunks.open_chunks(folder)
    differing = made.differences({key: store.attributes.get(key) for key in facts}, facts)
    if differing:
        raise StudyError(
            f"{folder}: holds another study's trials; what differs: {'; '.join(differing)}"
        )
    return store


def _programs(design: Design, method: Part) -> Iterator[_Program]:
    """Return a method's programs: one for each choice of static values."""
    axes = [(part, field) for part in (design.scene, method) for field in part.grid]
    cells = list(itertools.product(*(part.grid[field] for part, field in axes)))
    groups: dict[tuple[Any, ...], list[int]] = {}
    for number, cell in enumerate(cells):
        fixed = zip(axes, cell, strict=True)
        key = tuple(value for (part, field), value in fixed if field in part.static)
        groups.setdefault(key, []).append(number)
    for members in groups.values():
        chosen: dict[str, dict[str, list[Any]]] = {}  # values of all cells, by part and field
        for part in (design.scene, method, *design.metrics):
            chosen[part.where] = {
                field: [value] * len(members) for field, value in part.fields.items()
            }
        for place, (part, field) in enumerate(axes):
            chosen[part.where][field] = [cells[number][place] for number in members]
        yield _program(design, method, chosen, members)


def _program(
    design: Design, method: Part, chosen: dict[str, dict[str, list[Any]]], cells: list[int]
) -> _Program:
    parts = (design.scene, method, *design.metrics)
    dtype = np.dtype(jax.dtypes.canonicalize_dtype(float))
    static = {
        part.where: {f: v[0] for f, v in chosen[part.where].items() if f in part.static}
        for part in parts
    }
    traced = {
        part.where: {
            f: np.asarray(v, dtype) for f, v in chosen[part.where].items() if f not in part.static
        }
        for part in parts
    }

    def call(part: Part, params: Any, *given: Any) -> Any:
        with _named(part):
            return part.call(*given, **static[part.where], **params[0][part.where])

    def trial(key: Key, params: Any) -> dict[str, Array]:
        scene = call(design.scene, params, key)
        estimate = call(method, params, scene)
        return {
            metric.name: jnp.asarray(call(metric, params, scene, estimate))
            for metric in design.metrics
        }

    # The cells' numbers are there for studies without any traced field.
    return _Program(method, trial, (traced, np.arange(len(cells))), cells)


@contextmanager
def _named(part: Part) -> Iterator[None]:
    """Say whose function it is that fails."""
    try:
        yield
    except StudyError:
        raise
    except Exception as error:
        text = " ".join(str(error).split())
        text = text if len(text) < 300 else f"{text[:300]} …"
        if isinstance(error, jax.errors.JAXTypeError) or "Trace" in text:
            text += " (numbers are traced, unless `static` names their fields)"
        trace, place = error.__traceback__, ""
        while trace is not None:
            code = trace.tb_frame.f_code
            if code.co_filename == getattr(getattr(part.call, "__code__", None), "co_filename", 0):
                place = f" ({code.co_filename}, line {trace.tb_lineno})"
            trace = trace.tb_next
        raise StudyError(f"{part.where}: {type(error).__name__}: {text}{place}") from error


def _variables(design: Design, programs: list[_Program]) -> dict[str, chunks.Variable]:
    """Return what is stored, by name: `<method>.<metric>`."""
    found: dict[str, chunks.Variable] = {}
    key = jax.random.key(design.seed)
    for program in programs:
        method = program.method
        grid = {**design.scene.grid, **{f"{method.name}.{f}": v for f, v in method.grid.items()}}
        first = jax.tree.map(lambda leaf: leaf[0], program.params)
        for name, leaf in jax.eval_shape(program.trial, key, first).items():
            full = f"{method.name}.{name}"
            numeric = jnp.issubdtype(leaf.dtype, jnp.number) or leaf.dtype == jnp.bool_
            if leaf.shape or not numeric or jnp.issubdtype(leaf.dtype, jnp.complexfloating):
                got = f"{leaf.dtype} of shape {list(leaf.shape)}"
                raise StudyError(f"metric.{name}: got {got} of method {method.name}, want a number")
            shape = tuple(len(values) for values in grid.values())
            variable = chunks.Variable(tuple(grid), shape, str(leaf.dtype))
            if found.setdefault(full, variable) != variable:
                both = f"{found[full].dtype} and {leaf.dtype}"
                raise StudyError(f"metric.{name}: got {both}, want one dtype in all cells")
    return found


def _compute(
    design: Design,
    programs: list[_Program],
    variables: dict[str, chunks.Variable],
    first: int,
    end: int,
    report: Callable[[float], None],
) -> dict[str, np.ndarray]:
    """Return a chunk's values, `[grid …, trials]`."""
    flat = {
        name: np.empty((int(np.prod(variable.shape)), end - first), variable.dtype)
        for name, variable in variables.items()
    }
    for place, program in enumerate(programs):
        run = monte_carlo(
            program.trial,
            jax.random.key(design.seed),
            end - first,
            program.params,
            micro_batch=design.micro_batch,
            first_trial=first,
            batch_params=True,
            on_progress=lambda done, all_, at=place: report((at + done / all_) / len(programs)),
        )
        for name, leaf in run.values.items():
            flat[f"{program.method.name}.{name}"][program.cells] = leaf
    return {name: x.reshape(*variables[name].shape, end - first) for name, x in flat.items()}


def _total(
    design: Design, found: summary.Moments | None, last: tuple[str, float, float] | None
) -> float:
    """Return how many trials there will be; an error falls with their square root."""
    if design.until is None or found is None or last is None or not np.isfinite(last[2]):
        return design.trials
    return min(design.trials, max(found.trials * (last[2] / design.until.se) ** 2, found.trials))
