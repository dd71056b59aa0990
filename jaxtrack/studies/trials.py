"""What one chunk of a study's trials computes: scene, method, metrics, in every cell of the grid.

A method is one program. Its cells differ in traced values, but for those of static fields: each
choice of these is a program of its own.
"""

import itertools
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from jaxtrack.montecarlo import monte_carlo
from jaxtrack.studies.chunks import Variable
from jaxtrack.studies.design import Design, Part, axes_of
from jaxtrack.studies.functions import beside
from jaxtrack.studies.study_file import StudyError
from jaxtrack.types import Array, Key


class Program(NamedTuple):
    """What one compiled program computes of a method."""

    method: Part
    trial: Callable[[Key, Any], dict[str, Array]]
    params: Any  # leaves [P, …]
    cells: list[int]  # [P] of the method's


def programs_of(design: Design) -> list[Program]:
    """Return all programs of a study."""
    return [program for method in design.methods for program in _programs(design, method)]


def _programs(design: Design, method: Part) -> Iterator[Program]:
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
) -> Program:
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
        with _named(design, part, given), beside(design.folder):
            return part.call(*given, **static[part.where], **params[0][part.where])

    def trial(key: Key, params: Any) -> dict[str, Array]:
        scene = call(design.scene, params, key)
        estimate = call(method, params, scene)
        found = {}
        for metric in design.metrics:
            value = call(metric, params, scene, estimate)
            with _named(design, metric, (scene, estimate)):
                found[metric.name] = jnp.asarray(value)
        return found

    # The cells' numbers are there for studies without any traced field.
    return Program(method, trial, (traced, np.arange(len(cells))), cells)


@contextmanager
def _named(design: Design, part: Part, given: Any = ()) -> Iterator[None]:
    """Say whose function it is that fails, and where the study names it."""
    at = (*part.where.split("."), "function")
    try:
        yield
    except StudyError:
        raise
    except KeyboardInterrupt as error:  # the user's, most likely
        raise KeyboardInterrupt(f"in {part.where}{_place(part, error)}") from error
    except (Exception, SystemExit) as error:
        text = f"{type(error).__name__}: {_short(error)}"
        if isinstance(error, jax.errors.JAXTypeError) or "concrete" in text:
            text += " (numbers are traced, unless `static` names their fields)"
        design.file.fail(at, f"{text}{_place(part, error)}{_shapes(part, given)}")


def _short(error: BaseException) -> str:
    """Return what an error says, in one line: of a long one how it begins and ends."""
    text = " ".join(str(error).split())
    return text if len(text) < 300 else f"{text[:150]} … {text[-150:]}"


def _place(part: Part, error: BaseException) -> str:
    """Return the line in the function's own file at which it fails."""
    trace, place = error.__traceback__, ""
    own = getattr(getattr(part.call, "__code__", None), "co_filename", None)
    while trace is not None:
        if trace.tb_frame.f_code.co_filename == own:
            place = f" ({own}, line {trace.tb_lineno})"
        trace = trace.tb_next
    return place


def _shapes(part: Part, given: Any) -> str:
    """Return what a method or a metric was given, as the one who gave it may be to blame."""
    leaves = [
        f"{x.dtype}{list(x.shape)}" if isinstance(x, (np.ndarray, Array)) else type(x).__name__
        for x in jax.tree.leaves(given)
    ]
    if part.where == "scene" or not leaves:
        return ""
    return f"; it was given {', '.join(leaves[:6])}{', …' if len(leaves) > 6 else ''}"


def variables_of(design: Design, programs: list[Program]) -> dict[str, Variable]:
    """Return what is stored, by name: `<method>.<metric>`."""
    found: dict[str, Variable] = {}
    key = jax.random.key(design.seed)
    for program in programs:
        method = program.method
        grid = axes_of(design, method)
        first = jax.tree.map(lambda leaf: leaf[0], program.params)
        for name, leaf in jax.eval_shape(program.trial, key, first).items():
            full = f"{method.name}.{name}"
            numeric = jnp.issubdtype(leaf.dtype, jnp.number) or leaf.dtype == jnp.bool_
            if leaf.shape or not numeric or jnp.issubdtype(leaf.dtype, jnp.complexfloating):
                got = f"{leaf.dtype} of shape {list(leaf.shape)}"
                at = ("metric", name, "function")
                design.file.fail(at, f"got {got} of method {method.name}, want a number")
            shape = tuple(len(values) for values in grid.values())
            variable = Variable(tuple(grid), shape, str(leaf.dtype))
            if found.setdefault(full, variable) != variable:
                both = f"{found[full].dtype} and {leaf.dtype}"
                at = ("metric", name, "function")
                design.file.fail(at, f"got {both}, want one dtype in all cells")
    return found


def compute(
    design: Design,
    programs: list[Program],
    variables: dict[str, Variable],
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
        try:
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
        except jax.errors.JaxRuntimeError as error:  # no memory, or Python that is called fails
            at = ("method", program.method.name, "function")
            design.file.fail(at, f"fails in trials {first} to {end - 1}: {_short(error)}")
        for name, leaf in run.values.items():
            flat[f"{program.method.name}.{name}"][program.cells] = leaf
    return {name: x.reshape(*variables[name].shape, end - first) for name, x in flat.items()}
