"""The training loop: parameters down the gradient of a mean loss over simulated realizations."""

import functools
import os
import pathlib
import warnings
from collections.abc import Callable, Hashable
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
import optax

from jaxtrack.montecarlo import MonteCarlo, monte_carlo
from jaxtrack.numerics.bijectors import Bijector, bijector_of, identity
from jaxtrack.numerics.checks import check_array, check_key, check_known, check_size
from jaxtrack.numerics.safe import as_float
from jaxtrack.tuning.checkpoint import digest, read, write
from jaxtrack.tuning.clipping import length, shortened
from jaxtrack.tuning.objectives import mean_loss, programs
from jaxtrack.types import Array, Key

_TRAINING, _HELD_OUT = 0, 1  # streams of random keys


class FitHistory(NamedTuple):
    """What happened, in NumPy: S steps were made, E evaluations, the first before any step."""

    loss: np.ndarray  # [S] mean over the batch, before the step
    loss_error: np.ndarray  # [S] its standard error
    grad_norm: np.ndarray  # [S] of the mean gradient in the free parameters, before clipping
    finite: np.ndarray  # [S] False: the loss or its gradient was not, and the step was left out
    params: Any  # leaves [S + 1, ...], the first before any step
    evaluated: np.ndarray  # [E] after how many steps
    held_out: np.ndarray  # [E] mean loss on the held-out realizations
    held_out_error: np.ndarray  # [E] its standard error
    realizations: np.ndarray  # [E] simulated so far, for steps and for evaluations


class FitResult(NamedTuple):
    """The parameters with the least held-out loss, and how they were found."""

    params: Any  # those of `best_step`
    best_step: int
    held_out: float  # their loss; as the least of several a little too good
    held_out_error: float
    stopped_early: bool
    history: FitHistory


class _State(NamedTuple):
    """What goes on, and what is written to disk."""

    free: Any
    memory: Any  # the optimizer's
    history: FitHistory


def fit(
    loss: Callable[[Any, Key], Array],
    params: Any,
    optimizer: optax.GradientTransformation,
    *,
    key: Key,
    steps: int,
    batch: int,
    holdout: int,
    bijectors: Any = None,
    fresh: bool = True,
    clip: float | None = None,
    every: int = 10,
    patience: int | None = None,
    micro_batch: int = 8,
    checkpoint: str | os.PathLike[str] | None = None,
    progress: Callable[[int, int], None] | None = None,
) -> FitResult:
    """Minimize the mean of a loss over realizations.

        u ← u + optimizer(mean over b of ∇_u L(g(u), key_b)),   params = g(u)

    with g the bijectors. Losses and gradients of a batch are a run of `monte_carlo`: on all local
    devices, and equal bit for bit whatever their number at an equal micro-batch.

    Args:
        loss: `(params, key) -> []` of one realization, differentiable in the parameters; define it
            once, for each new function object is compiled anew.
        params: pytree of numbers and arrays to start from, inside their bijectors' range.
        optimizer: any of optax; a schedule counts its steps. A line search, as in `optax.lbfgs`,
            goes by the mean loss of the step's realizations: let them be common, `fresh=False`.
            `optax.contrib.sam`, which takes no such extras, is not offered.
        key: all randomness; a step's realizations have keys of their own.
        steps: at most.
        batch: realizations a step.
        holdout: realizations of every evaluation, always the same and never trained on.
        bijectors: pytree of `numerics.Bijector` in the parameters' structure, or one for all that
            is below it; None: parameters are free.
        fresh: new realizations each step; False: the same (common random numbers), where `batch`
            bounds how well the parameters can get.
        clip: largest norm of the mean gradient in the free parameters; longer ones are scaled down.
            Where single realizations are wild, `clip_each` the loss instead.
        every: steps between evaluations; the last step is evaluated too.
        patience: evaluations without a new least held-out loss until it stops early; None: never.
        micro_batch: realizations under one `vmap`, see `monte_carlo`.
        checkpoint: folder; what stands there is gone on with, to the result, bit for bit, of a
            run that was not interrupted. It may have had fewer `steps`.
        progress: called as `progress(steps done, steps)` after each step.

    Raises:
        TypeError: an argument is of another kind than is wanted.
        ValueError: a size is too small, bijectors do not fit, the loss is no single number, at the
            start it is not finite, or its gradient is in no step until the first evaluation,
            parameters lie outside their bijectors' range, or the checkpoint is another fit's or
            cannot be read.

    Example:
        >>> def squared(params, key):
        ...     return (params["scale"] - 3.0 - 0.1 * jax.random.normal(key)) ** 2
        >>> from jaxtrack.numerics import positive
        >>> result = fit(squared, {"scale": 1.0}, optax.adam(0.1), key=jax.random.key(0), steps=60,
        ...              batch=8, holdout=32, bijectors={"scale": positive()})
        >>> print(f"{result.params['scale']:.1f}, {result.history.realizations[-1]} realizations")
        3.0, 704 realizations

    Note:
        A step whose loss, gradient or change is not finite is left out and marked in the history;
        if there were any, a RuntimeWarning says so at the end. Line searches run on one device.
        The digest of a checkpoint sees the optimizer's state but neither its code nor the loss's:
        change one, and the folder has to be emptied.
    """
    check_key("key", key)
    sizes = {"steps": steps, "batch": batch, "holdout": holdout, "every": every}
    for name, size in sizes.items():
        check_size(name, size)
    if patience is not None:
        check_size("patience", patience)
    if clip is not None:
        check_array("clip", clip, shape=())
        check_known("clip", clip, lambda c: c > 0, "a positive number")
    if not (callable(loss) and isinstance(loss, Hashable)):
        raise TypeError(f"loss: got {type(loss).__name__}, want a hashable function of params, key")
    if not all(callable(getattr(optimizer, part, None)) for part in ("init", "update")):
        raise TypeError(
            f"optimizer: got {type(optimizer).__name__}, want one of optax, as optax.adam(0.1)"
        )
    bijector = bijector_of(identity() if bijectors is None else bijectors)
    start, free = _begin(params, bijector)
    optimizer = optax.with_extra_args_support(optimizer)
    with jax.numpy_dtype_promotion("standard"):
        memory = optimizer.init(free)
    state = _State(free, memory, _no_history(start))
    folder = None if checkpoint is None else pathlib.Path(checkpoint)
    bound = None if clip is None else float(clip)
    settings = batch, holdout, bool(fresh), bound, every, patience, micro_batch
    made_by = digest(key, (start, free, memory), *settings)
    if folder is not None:
        state = read(folder, made_by, state) or state
    free, memory, history = state
    made, tried = len(history.loss), len(history.evaluated)
    if made > steps:
        kept = f"{made} steps stand in {folder}"
        raise ValueError(f"steps: got {steps}, want no fewer than what was made: {kept}")
    history = _sized(history, steps, 2 + steps // every)

    value, slope = programs(loss)
    training, held_out = (jax.random.fold_in(key, stream) for stream in (_TRAINING, _HELD_OUT))
    on_batch = functools.partial(monte_carlo, trials=batch, micro_batch=micro_batch)
    advance = _advance(optimizer, bijector, clip, functools.partial(on_batch, value))
    at = lambda step: jax.tree.map(lambda table: table[step], history.params)

    def evaluate() -> None:
        nonlocal tried
        run = mean_loss(loss, at(made), key=held_out, realizations=holdout, micro_batch=micro_batch)
        if made == 0:
            _check_loss(run)
        elif not history.finite[:made].any():
            got = f"{history.loss[made - 1]} and a gradient of norm {history.grad_norm[made - 1]}"
            raise ValueError(f"loss: got {got}, as in all {made} steps, want finite ones")
        spent = made * batch + (tried + 1) * holdout
        found = {"held_out": run.mean, "held_out_error": run.standard_error}
        _note(history, tried, evaluated=made, realizations=spent, **found)
        tried += 1
        if folder is not None and made % every == 0:
            write(folder, made_by, _State(free, memory, _sized(history, made, tried)))

    if tried == 0:
        evaluate()
    while made < steps and not _waited(history.held_out[:tried], patience):
        step_key = jax.random.fold_in(training, made + 1 if fresh else 0)
        run = on_batch(slope, step_key, params=at(made))
        free, memory, *seen = advance(free, memory, *run.mean, step_key)
        norm, finite, after = jax.device_get(seen)
        found = {"loss": run.mean[0], "loss_error": run.standard_error[0]}
        _note(history, made, grad_norm=norm, finite=finite, **found)
        made += 1
        _note(history, made, params=after)
        if made % every == 0 or made == steps:
            evaluate()
        if progress is not None:
            progress(made, steps)

    history = _sized(history, made, tried)
    if (left_out := int((~history.finite).sum())) > 0:
        what = f"{left_out} of {made} steps were left out"
        warnings.warn(f"fit: {what}, as they were not finite", RuntimeWarning, stacklevel=2)
    best = int(np.nanargmin(history.held_out))
    step = int(history.evaluated[best])
    return FitResult(
        params=jax.tree.map(jnp.asarray, at(step)),
        best_step=step,
        held_out=float(history.held_out[best]),
        held_out_error=float(history.held_out_error[best]),
        stopped_early=made < steps,
        history=history,
    )


def _advance(
    optimizer: optax.GradientTransformationExtraArgs,
    bijector: Bijector,
    clip: float | None,
    on_batch: Callable[..., MonteCarlo],
) -> Callable[..., Any]:
    """Return the compiled step from a mean loss and its gradient in the parameters."""

    def advance(free: Any, memory: Any, loss: Any, in_params: Any, key: Key) -> tuple[Any, ...]:
        _, back = jax.vjp(bijector.forward, free)
        (gradient,) = back(in_params)
        norm = length(gradient)
        clipped = gradient if clip is None else shortened(gradient, norm, clip)
        # What a line search evaluates; others never trace it.
        elsewhere = lambda u: on_batch(key, params=bijector.forward(u)).mean
        extra = {"value": loss, "grad": gradient, "value_fn": elsewhere}
        # Optimizers mix dtypes harmlessly.
        with jax.numpy_dtype_promotion("standard"):
            change, after = optimizer.update(clipped, memory, free, **extra)
            moved = optax.apply_updates(free, change)
        finite = jnp.isfinite(loss) & jnp.isfinite(norm) & jnp.isfinite(optax.tree.norm(change))
        keep = lambda new, old: jax.tree.map(lambda x, y: jnp.where(finite, x, y), new, old)
        free, memory = keep(moved, free), keep(after, memory)
        return free, memory, norm, finite, bijector.forward(free)

    return jax.jit(advance)


def _begin(params: Any, bijector: Bijector) -> tuple[Any, Any]:
    """Return where parameters start, and where that is on the reals."""
    named = lambda tree: [
        (f"params{jax.tree_util.keystr(path)}", leaf)
        for path, leaf in jax.tree.leaves_with_path(tree)
    ]
    for name, x in named(params):
        check_array(name, x)
    start = jax.tree.map(as_float, params)
    free = bijector.inverse(start)
    # What they do not lead back to could not be trained.
    for (name, x), y in zip(named(start), jax.tree.leaves(bijector.forward(free)), strict=True):
        x, y = np.asarray(x), np.asarray(y)
        if not np.allclose(x, y, rtol=1e-3, atol=np.finfo(x.dtype).tiny):
            raise ValueError(f"{name}: got {x}, want it inside its bijector's range, which has {y}")
    return start, free


def _check_loss(run: MonteCarlo) -> None:
    """Refuse what has no gradient, or no value where the fit starts."""
    check_array("loss", run.mean, shape=())
    if not jnp.issubdtype(run.values.dtype, jnp.floating):
        raise TypeError(f"loss: got dtype {run.values.dtype}, want floating numbers")
    if not np.isfinite(run.mean):
        raise ValueError(f"loss: got a mean of {run.mean} at the start, want a finite one")


def _no_history(start: Any) -> FitHistory:
    none, params = np.zeros(0), jax.tree.map(lambda x: np.asarray(x)[None], start)
    count, flag = none.astype(int), none.astype(bool)
    return FitHistory(none, none, none, flag, params, count, none, none, count)


def _sized(history: FitHistory, steps: int, evaluations: int) -> FitHistory:
    """Return a history with so many rows: the first of those there are, or room for more."""

    def sized(rows: int, table: np.ndarray) -> np.ndarray:
        more = max(rows - len(table), 0)
        return np.concatenate([table, np.zeros((more, *table.shape[1:]), table.dtype)])[:rows]

    rows = [*[steps] * 4, steps + 1, *[evaluations] * 4]
    tables = zip(rows, history, strict=True)
    return FitHistory._make(jax.tree.map(functools.partial(sized, n), x) for n, x in tables)


def _note(history: FitHistory, row: int, **found: Any) -> None:
    for name, values in found.items():
        jax.tree.map(lambda table, x: table.__setitem__(row, x), getattr(history, name), values)


def _waited(held_out: np.ndarray, patience: int | None) -> bool:
    """Whether so many evaluations have passed since the best one."""
    return patience is not None and len(held_out) - 1 - int(np.nanargmin(held_out)) >= patience
