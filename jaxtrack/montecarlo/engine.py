"""Thousands of independent trials of one function, in one compiled program of fixed shape."""

import functools
from collections.abc import Callable, Hashable
from typing import Any, NamedTuple

import jax
import jax.core
import jax.numpy as jnp

from jaxtrack.montecarlo.advice import warn_of_idle_cores
from jaxtrack.montecarlo.blocks import Plan, check_outputs, run_in_blocks, run_micro_batch
from jaxtrack.montecarlo.statistics import mean_and_error
from jaxtrack.numerics import checks
from jaxtrack.types import Key

_LAST_TRIAL = 2**32 - 1  # `fold_in` takes 32 bits


class MonteCarlo(NamedTuple):
    """What many trials gave."""

    values: Any  # the pytree fn returns, leaves [trials, ...]; [P, trials, ...] with batch_params
    mean: Any  # the same pytree without the trial axis
    standard_error: Any  # of the mean; infinite for a single trial
    trials: int
    micro_batch: int  # trials under one vmap; at an equal micro-batch results are bit-equal


def monte_carlo(
    fn: Callable[[Key, Any], Any],
    key: Key,
    trials: int,
    params: Any = None,
    *,
    micro_batch: int = 32,
    first_trial: int = 0,
    batch_params: bool = False,
    on_progress: Callable[[int, int], None] | None = None,
) -> MonteCarlo:
    """Run `fn(fold_in(key, trial), params)` for `first_trial ≤ trial < first_trial + trials`.

    Trial t is always lane `t mod micro_batch` of micro-batch `t // micro_batch`, beside the same
    neighbours, whatever the devices and wherever a run starts or ends: at an equal micro-batch its
    result is the same bit for bit. The program is compiled once for a function, for any values of
    the parameters and any number of trials; all local devices take part.

    Called with concrete arguments, the results are gathered in host memory (NumPy) block by block,
    so a device never holds more than a few blocks. Called under `jax.grad`, `jax.jit` or
    `jax.vmap`, the same micro-batches run one after another on one device, the values stay JAX
    arrays and the backward pass recomputes each micro-batch, so that it needs the memory of one.

    Args:
        fn: one trial, `(key, params) -> pytree of arrays`; hashable. It is compiled anew for
            each new function object, so define it once rather than in a loop.
        key: a typed key, from `jax.random.key(seed)`.
        trials: how many.
        params: any pytree of numbers and arrays, traced; all trials share it.
        micro_batch: how many trials go under one `vmap`. Draws do not depend on it; continuous
            results do within rounding.
        first_trial: where to start: 77 trials from 60 on continue a run of 60 trials. Multiples
            of the micro-batch waste nothing; else two micro-batches are computed in part for
            trials that nobody asked for.
        batch_params: the leaves of `params` carry a leading axis `[P]`, and every trial runs
            with each of the P sets on the same key (common random numbers), one set after another.
        on_progress: called as `on_progress(done, trials)` after each block; not while tracing.

    Returns:
        Values, means and standard errors; see `MonteCarlo`.

    Raises:
        TypeError: `key` is not a typed key, or `fn` is not hashable, closes over traced values or
            returns something else than real numbers.
        ValueError: a size is out of range, or the leaves of batched `params` differ in length.

    Example:
        >>> def squared_noise(key, sigma_m):
        ...     return (sigma_m * jax.random.normal(key)) ** 2
        >>> run = monte_carlo(squared_noise, jax.random.key(0), trials=1000, params=2.0)
        >>> run.values.shape
        (1000,)
        >>> abs(float(run.mean) - 4.0) < 5 * float(run.standard_error)
        True
        >>> slope = jax.grad(lambda s: monte_carlo(squared_noise, jax.random.key(0), 64, s).mean)
        >>> bool(slope(2.0) > 0)
        True
    """
    trials = checks.check_size("trials", trials)
    micro_batch = checks.check_size("micro_batch", micro_batch)
    first_trial = checks.check_size("first_trial", first_trial, at_least=0)
    if first_trial + trials - 1 > _LAST_TRIAL:
        raise ValueError(f"trials: got trial {first_trial + trials - 1} as the last, want < 2^32")
    checks.check_key("key", key)
    if not (callable(fn) and isinstance(fn, Hashable)):
        raise TypeError(f"fn: got {type(fn).__name__}, want a hashable callable")
    if batch_params:
        _check_batch(params)

    # The first and the last micro-batch are computed whole, with the true neighbours of the wanted
    # trials, and cut afterwards: the place within a vmap may decide how a sum is rounded.
    plan = Plan(fn, micro_batch, bool(batch_params))
    batches = range(first_trial // micro_batch, -(-(first_trial + trials) // micro_batch))
    skipped = first_trial - batches.start * micro_batch

    def report(batches_done: int) -> None:
        if on_progress is not None:
            on_progress(min(batches_done * micro_batch - skipped, trials), trials)

    if _is_traced(key, params):
        rows = _run_traced(plan, key, params, batches)
    else:
        warn_of_idle_cores(trials)
        rows = run_in_blocks(plan, key, params, batches, report)

    axis = int(plan.batch_params)
    wanted = (slice(None),) * axis + (slice(skipped, skipped + trials),)

    def cut(leaf: Any) -> Any:  # [(P,) batches, micro_batch, ...] -> [(P,) trials, ...]
        flat = (*leaf.shape[:axis], len(batches) * micro_batch, *leaf.shape[axis + 2 :])
        return leaf.reshape(flat)[wanted]

    leaves, structure = jax.tree.flatten(jax.tree.map(cut, rows))
    moments = [mean_and_error(leaf, axis=axis) for leaf in leaves]
    return MonteCarlo(
        values=structure.unflatten(leaves),
        mean=structure.unflatten([mean for mean, _ in moments]),
        standard_error=structure.unflatten([error for _, error in moments]),
        trials=trials,
        micro_batch=micro_batch,
    )


def _run_traced(plan: Plan, key: Key, params: Any, batches: range) -> Any:
    """Run micro-batches differentiably: leaves `[(P,) len(batches), micro_batch, ...]`."""
    indices = jnp.uint32(batches.start) + jnp.arange(len(batches), dtype=jnp.uint32)
    rows = _traced_program(plan)(key, params, indices)
    check_outputs(rows)
    return jax.tree.map(lambda leaf: jnp.moveaxis(leaf, 0, int(plan.batch_params)), rows)


@functools.lru_cache(maxsize=64)
def _traced_program(plan: Plan) -> Callable[[Key, Any, jax.Array], Any]:
    """Return the loop over micro-batches, the same object for a plan: one compilation for all."""

    def program(key: Key, params: Any, indices: jax.Array) -> Any:
        # Inside a loop nothing can be merged across the checkpoint anyway, hence no barrier.
        body = jax.checkpoint(
            lambda index: run_micro_batch(plan, key, params, index), prevent_cse=False
        )
        return jax.lax.map(body, indices)

    return jax.jit(program)


def _is_traced(key: Key, params: Any) -> bool:
    """Whether an argument is traced, or everything is (inside `jax.jit`)."""
    leaves = [key, *jax.tree.leaves(params), jnp.zeros(())]
    return any(isinstance(leaf, jax.core.Tracer) for leaf in leaves)


def _check_batch(params: Any) -> None:
    shapes = [jnp.shape(leaf) for leaf in jax.tree.leaves(params)]
    lengths = {shape[0] if shape else 0 for shape in shapes}
    if len(lengths) != 1 or lengths == {0}:
        got = ", ".join(str(list(shape)) for shape in shapes) or "no leaves"
        raise ValueError(f"params: got shapes {got}, want one leading axis [P] on every leaf")
