"""Trials kept on disk while a study runs, so that an interrupted one goes on where it was."""

import hashlib
import pathlib
import shutil
from collections.abc import Callable
from typing import Any

import jax
import numpy as np

from jaxtrack.montecarlo import monte_carlo
from jaxtrack.studies.registry import Context
from jaxtrack.studies.store import source_digest
from jaxtrack.types import Key

FOLDER = "parts"


def run_part(
    context: Context,
    name: str,
    fn: Callable[[Key, Any], Any],
    key: Key,
    trials: int,
    params: Any,
    on_progress: Callable[[int, int], None] | None = None,
) -> Any:
    """Return the values of `monte_carlo(fn, key, trials, params)`, run one by one.

    What an earlier run of the same study left is read instead, if its key, parameters and number
    of trials were the same, and the program and JAX are what they were; else it is replaced.

    Args:
        context: of the study; parts lie in its folder.
        name: of the file.
        fn: one trial, as `monte_carlo` takes it; so are the others.
        key: of the run.
        trials: how many.
        params: shared by all trials.
        on_progress: called as `on_progress(done, trials)`.
    """
    # Singly: a batch of vote tables would leave the cache.
    compute = lambda: monte_carlo(fn, key, trials, params, micro_batch=1, on_progress=on_progress)
    like = jax.eval_shape(fn, key, params)
    return keep_part(context, name, lambda: compute().values, like, key, trials, params)


def keep_part(
    context: Context,
    name: str,
    compute: Callable[[], Any],
    like: Any,
    key: Key,
    trials: int,
    params: Any,
) -> Any:
    """Return what `compute` does, or what an earlier run of the same study kept of it.

    Args:
        context: of the study; parts lie in its folder.
        name: of the file.
        compute: returns a pytree of arrays.
        like: a pytree of the same structure.
        key: with the number of trials and the parameters what the result depends on.
        trials: how many.
        params: pytree.
    """
    file = context.out / FOLDER / f"{name}.npz"
    made_by = _digest(key, trials, params)
    if file.exists():
        with np.load(file) as kept:
            if str(kept["made_by"]) == made_by:
                structure = jax.tree.structure(like)
                return structure.unflatten([kept[f"leaf_{n}"] for n in range(len(kept) - 1)])
    values = compute()
    leaves = {f"leaf_{n}": leaf for n, leaf in enumerate(jax.tree.leaves(values))}
    file.parent.mkdir(parents=True, exist_ok=True)
    half = file.with_suffix(".half.npz")
    np.savez(half, made_by=made_by, **leaves)
    half.replace(file)  # at once: a run that dies while writing leaves no broken part
    return values


def folder_of(context: Context, name: str) -> pathlib.Path:
    """Return a folder among the parts for what keeps its own state, of this program alone."""
    program = hashlib.sha256(_program().encode()).hexdigest()[:12]
    return context.out / FOLDER / f"{name} {program}"


def forget_parts(context: Context) -> None:
    """Remove the parts of a study whose results are saved."""
    shutil.rmtree(context.out / FOLDER, ignore_errors=True)


def _digest(key: Key, trials: int, params: Any) -> str:
    digest = hashlib.sha256(f"{_program()} {trials} {jax.tree.structure(params)}".encode())
    for leaf in (jax.random.key_data(key), *jax.tree.leaves(params)):
        array = np.asarray(leaf)
        digest.update(f"{array.dtype}{array.shape}".encode() + array.tobytes())
    return digest.hexdigest()


def _program() -> str:
    """Return the versions, and a digest of the package's own source."""
    return f"{jax.__version__} {np.__version__} {source_digest()}"
