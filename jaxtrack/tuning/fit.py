"""The training loop: parameters down the gradient of a mean loss over simulated realizations."""

import os
import pathlib
from collections.abc import Callable
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
import optax

from jaxtrack.montecarlo import monte_carlo
from jaxtrack.numerics.bijectors import Bijector, bijector_of, identity
from jaxtrack.numerics.checks import check_key, check_known, check_size
from jaxtrack.numerics.safe import as_float
from jaxtrack.tuning.checkpoint import digest, read, write
from jaxtrack.tuning.realizations import mean_loss, programs
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


class _Made(NamedTuple):
    """One step; the first stands for the start."""

    loss: Any
    loss_error: Any
    grad_norm: Any
    finite: Any
    params: Any  # after it


class _Evaluation(NamedTuple):
    step: Any
    mean: Any
    error: Any


class _State(NamedTuple):
    """What goes on, and what is written to disk: there the lists are stacked."""

    free: Any
    memory: Any  # the optimizer's
    made: list[_Made]
    evaluations: list[_Evaluation]


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
        optimizer: of optax; a schedule counts its steps. Those that read the loss get it, as
            `value`; a line search, which evaluates it at other points, is not offered.
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
        TypeError: a size is no Python int, parameters are no numbers, or bijectors are none.
        ValueError: a size is too small, bijectors do not fit, the loss at the start is not finite,
            parameters lie outside their bijectors' range, or the checkpoint is another fit's.

    Example:
        >>> def squared(params, key):
        ...     return (params["scale"] - 3.0 - 0.1 * jax.random.normal(key)) ** 2
        >>> from jaxtrack.numerics import positive
        >>> result = fit(squared, {"scale": 1.0}, optax.adam(0.1), key=jax.random.key(0), steps=60,
        ...              batch=8, holdout=32, bijectors={"scale": positive()})
        >>> print(f"{result.params['scale']:.1f}, {result.history.realizations[-1]} realizations")
        3.0, 704 realizations

    Note:
        A step whose loss or gradient is not finite changes nothing and is marked in the history.
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
        check_known("clip", clip, lambda c: c > 0, "a positive number")
    bijector = bijector_of(identity() if bijectors is None else bijectors)
    start = jax.tree.map(as_float, params)
    free = bijector.inverse(start)
    _check_range(start, bijector.forward(free))
    optimizer = optax.with_extra_args_support(optimizer)
    with jax.numpy_dtype_promotion("standard"):
        memory = optimizer.init(free)
    nan = np.float64(np.nan)
    first = _Made(nan, nan, nan, np.bool_(True), jax.device_get(start))
    state = _State(free, memory, [first], [])
    folder = None if checkpoint is None else pathlib.Path(checkpoint)
    settings = batch, holdout, bool(fresh), clip, every, patience, micro_batch
    made_by = digest(key, (start, free, memory), *settings)
    if folder is not None:
        state = _resume(folder, made_by, state)
        if len(state.made) - 1 > steps:
            kept = f"{len(state.made) - 1} steps stand in {folder}"
            raise ValueError(f"steps: got {steps}, want no fewer than what was made: {kept}")

    _, slope = programs(loss)
    advance = _advance(optimizer, bijector, clip)
    training, held_out = (jax.random.fold_in(key, stream) for stream in (_TRAINING, _HELD_OUT))

    def evaluate() -> None:
        at = state.made[-1].params
        run = mean_loss(loss, at, key=held_out, realizations=holdout, micro_batch=micro_batch)
        done = len(state.made) - 1
        if done == 0 and not np.isfinite(run.mean):
            raise ValueError(f"loss: got a mean of {run.mean} at the start, want a finite one")
        state.evaluations.append(_Evaluation(np.int64(done), run.mean, run.standard_error))
        if folder is not None and done % every == 0:
            write(folder, made_by, _stacked(state))

    if not state.evaluations:
        evaluate()
    while len(state.made) <= steps and not _waited(state, patience):
        done = len(state.made)
        step_key = jax.random.fold_in(training, done if fresh else 0)
        at = state.made[-1].params
        run = monte_carlo(slope, step_key, batch, at, micro_batch=micro_batch)
        free, memory, *seen = advance(state.free, state.memory, *run.mean)
        state = state._replace(free=free, memory=memory)
        state.made.append(_Made(run.mean[0], run.standard_error[0], *jax.device_get(seen)))
        if done % every == 0 or done == steps:
            evaluate()
        if progress is not None:
            progress(done, steps)
    return _result(state, batch, holdout, stopped=_waited(state, patience))


def _advance(
    optimizer: optax.GradientTransformationExtraArgs, bijector: Bijector, clip: float | None
) -> Callable[..., Any]:
    """Return the compiled step from a mean loss and its gradient in the parameters."""

    def advance(free: Any, memory: Any, loss: Any, in_params: Any) -> tuple[Any, ...]:
        _, back = jax.vjp(bijector.forward, free)
        (gradient,) = back(in_params)
        norm = optax.tree.norm(gradient)
        finite = jnp.isfinite(loss) & jnp.isfinite(norm)
        if clip is not None:
            scale = jnp.where(norm > clip, clip / jnp.where(norm > clip, norm, 1.0), 1.0)
            gradient = jax.tree.map(lambda x: x * scale.astype(x.dtype), gradient)
        # Optimizers mix dtypes harmlessly.
        with jax.numpy_dtype_promotion("standard"):
            change, after = optimizer.update(gradient, memory, free, value=loss, grad=gradient)
            moved = optax.apply_updates(free, change)
        keep = lambda new, old: jax.tree.map(lambda x, y: jnp.where(finite, x, y), new, old)
        free, memory = keep(moved, free), keep(after, memory)
        return free, memory, norm, finite, bijector.forward(free)

    return jax.jit(advance)


def _check_range(start: Any, again: Any) -> None:
    """Refuse parameters that their bijectors do not lead back to: they could not be trained."""
    pairs = zip(jax.tree.leaves_with_path(start), jax.tree.leaves(again), strict=True)
    for (path, x), y in pairs:
        x, y = np.asarray(x), np.asarray(y)
        if not np.allclose(x, y, rtol=1e-3, atol=np.finfo(x.dtype).tiny):
            name = f"params{jax.tree_util.keystr(path)}"
            raise ValueError(f"{name}: got {x}, want it inside its bijector's range, which has {y}")


def _waited(state: _State, patience: int | None) -> bool:
    """Whether so many evaluations have passed since the best one."""
    means = [evaluation.mean for evaluation in state.evaluations]
    return patience is not None and len(means) - 1 - int(np.nanargmin(means)) >= patience


def _stacked(state: _State) -> Any:
    stack = lambda rows: jax.tree.map(lambda *x: np.stack(x), *rows)
    return state._replace(made=stack(state.made), evaluations=stack(state.evaluations))


def _resume(folder: pathlib.Path, made_by: str, state: _State) -> _State:
    """Return the state that stands in the folder, or the given one where there is none."""
    like = state._replace(made=state.made[0], evaluations=_Evaluation(0, 0, 0))
    kept = read(folder, made_by, like)
    if kept is None:
        return state
    rows = lambda table: [
        jax.tree.map(lambda x, at=n: x[at], table) for n in range(len(jax.tree.leaves(table)[0]))
    ]
    return kept._replace(made=rows(kept.made), evaluations=rows(kept.evaluations))


def _result(state: _State, batch: int, holdout: int, *, stopped: bool) -> FitResult:
    table = _stacked(state)
    tried, made = table.evaluations, table.made
    best = int(np.nanargmin(tried.mean))
    step = int(tried.step[best])
    return FitResult(
        params=jax.tree.map(jnp.asarray, state.made[step].params),
        best_step=step,
        held_out=float(tried.mean[best]),
        held_out_error=float(tried.error[best]),
        stopped_early=stopped,
        history=FitHistory(
            loss=made.loss[1:],
            loss_error=made.loss_error[1:],
            grad_norm=made.grad_norm[1:],
            finite=made.finite[1:],
            params=made.params,
            evaluated=tried.step,
            held_out=tried.mean,
            held_out_error=tried.error,
            realizations=tried.step * batch + holdout * np.arange(1, len(tried.step) + 1),
        ),
    )
