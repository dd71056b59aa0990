"""Scenes that break a tracker, found by gradient ascent on what makes a scene."""

import functools
from collections.abc import Callable
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
import optax

from jaxtrack.montecarlo import monte_carlo
from jaxtrack.numerics.bijectors import bounded
from jaxtrack.numerics.checks import check_array, check_key, check_size
from jaxtrack.numerics.safe import as_float
from jaxtrack.tuning.fit import fit
from jaxtrack.types import Array, Key

_STARTS, _ASCENT, _VERDICT, _ORDINARY = range(4)  # streams of random keys


class Falsified(NamedTuple):
    """Scenes found, the worst first, and how the tracker fares there; in NumPy, F starts."""

    scenes: Any  # leaves [F, ...]
    start: Any  # leaves [F, ...] where the ascent to each began
    loss: np.ndarray  # [F] of the soft tracker, on the ascent's held-out realizations
    score: Any  # leaves [F] means of the verdict on fresh realizations
    score_error: Any  # leaves [F] their standard errors
    ordinary: Any  # leaves [] means over scenes drawn within the bounds
    ordinary_error: Any  # leaves []
    realizations: int  # behind each mean


def falsify(
    loss: Callable[[Any, Key], Array],
    verdict: Callable[[Any, Key], Any],
    low: Any,
    high: Any,
    optimizer: optax.GradientTransformation,
    *,
    key: Key,
    starts: int,
    steps: int,
    batch: int,
    holdout: int,
    verify: int,
    clip: float | None = None,
    every: int = 10,
    micro_batch: int = 8,
) -> Falsified:
    """Search the scenes within bounds for those where a tracker's loss is largest.

        max over s in [low, high] of E loss(s, key)

    by `fit` on −loss, from random starts. What was found is then judged by another function, of
    the tracker as it is used, on realizations that neither ascent nor choice has seen; and so are
    ordinary scenes, each realization one of its own, uniform within the bounds.

    Args:
        loss: `(scene, key) -> []` of one realization, differentiable in the scene; define it once.
        verdict: `(scene, key) -> pytree of numbers`, the larger the worse; it need not have
            gradients. Scenes are sorted by its first leaf.
        low: pytree of numbers and arrays: the scene's parameters at their least.
        high: at their largest, in the same structure.
        optimizer: any of optax. It moves logits: a step of .2 is at most a twentieth of the range.
        key: all randomness.
        starts: F, how many ascents.
        steps: of each at most, as all that follows as `fit` takes it.
        batch: realizations a step.
        holdout: realizations of every evaluation.
        verify: realizations of each verdict.
        clip: largest norm of a gradient.
        every: steps between evaluations.
        micro_batch: realizations under one `vmap`.

    Raises:
        TypeError: a size is no Python int, or bounds are no numbers.
        ValueError: a size is too small, bounds do not fit together, or the loss at a start is not
            finite.

    Example:
        How near two targets have to be for JPDA to give one the other's detection:

        >>> from jaxtrack.association import jpda
        >>> def wrong(scene, key):  # the weight of the other's detection
        ...     places = jnp.array([0.0, 1.0]) * scene["apart_m"]
        ...     seen = places + jax.random.normal(key, (2,))
        ...     ratio = 100.0 * jnp.exp(-((seen[None, :] - places[:, None]) ** 2) / 2)
        ...     return jpda.marginals(ratio, jnp.full(2, 0.1))[0, 1]
        >>> mistaken = lambda scene, key: (wrong(scene, key) > 0.5).astype(float)
        >>> found = falsify(wrong, mistaken, {"apart_m": 0.5}, {"apart_m": 9.0}, optax.adam(0.3),
        ...                 key=jax.random.key(0), starts=2, steps=30, batch=16, holdout=64,
        ...                 verify=400)
        >>> print(found.scenes["apart_m"].round(1), found.score[0] > 3 * found.ordinary)
        [0.5 0.5] True

    Note:
        `score` does nothing but sort, yet the first of several is the largest of them: where that
        matters, run the verdict once more.
    """
    check_key("key", key)
    check_size("starts", starts)
    check_size("verify", verify)
    low, high = _check_bounds(low, high)
    streams = [jax.random.fold_in(key, stream) for stream in range(4)]
    _check_verdict(verdict, low, key)
    fitted, begun = [], []
    down, (judge, judge_any) = _negative(loss), _judges(verdict)
    for n in range(starts):
        begin = uniform_scene(jax.random.fold_in(streams[_STARTS], n), low, high)
        begun.append(begin)
        fitted.append(
            fit(
                down,
                begin,
                optimizer,
                key=jax.random.fold_in(streams[_ASCENT], n),
                steps=steps,
                batch=batch,
                holdout=holdout,
                bijectors=jax.tree.map(bounded, low, high),
                clip=clip,
                every=every,
                micro_batch=micro_batch,
            )
        )
    run = lambda fn, stream, at: monte_carlo(
        fn, streams[stream], verify, at, micro_batch=micro_batch
    )
    runs = [run(judge, _VERDICT, result.params) for result in fitted]
    ordinary = run(judge_any, _ORDINARY, (low, high))
    order = np.argsort([-jax.tree.leaves(one.mean)[0] for one in runs], stable=True)
    rows = lambda trees: jax.tree.map(
        lambda *x: np.stack(x), *(jax.device_get(trees[n]) for n in order)
    )
    return Falsified(
        scenes=rows([result.params for result in fitted]),
        start=rows(begun),
        loss=rows([-result.held_out for result in fitted]),
        score=rows([one.mean for one in runs]),
        score_error=rows([one.standard_error for one in runs]),
        ordinary=ordinary.mean,
        ordinary_error=ordinary.standard_error,
        realizations=verify,
    )


def uniform_scene(key: Key, low: Any, high: Any) -> Any:
    """Return a scene whose parameters are uniform within bounds: an ordinary one.

    Example:
        >>> print(uniform_scene(jax.random.key(0), {"gap_m": 2.0}, {"gap_m": 2.0}))
        {'gap_m': Array(2., dtype=float32)}
    """
    ends, structure = jax.tree.flatten(low)
    keys = jax.random.split(key, len(ends))
    draw = lambda key, a, b: jax.random.uniform(key, jnp.shape(a), as_float(a).dtype, a, b)
    return structure.unflatten(map(draw, keys, ends, jax.tree.leaves(high)))


@functools.lru_cache(maxsize=64)
def _negative(loss: Callable[[Any, Key], Array]) -> Callable[[Any, Key], Array]:
    """Return what `fit` minimizes: one function for a loss, so that it is compiled once."""
    return lambda scene, key: -loss(scene, key)


@functools.lru_cache(maxsize=64)
def _judges(verdict: Callable[[Any, Key], Any]) -> tuple[Callable[..., Any], Callable[..., Any]]:
    """Return the verdict as `monte_carlo` takes it: on a given scene, and on any within bounds."""

    def given(key: Key, scene: Any) -> Any:
        return verdict(scene, key)

    def ordinary(key: Key, bounds: tuple[Any, Any]) -> Any:
        place, rest = jax.random.split(key)
        return verdict(uniform_scene(place, *bounds), rest)

    return given, ordinary


def _check_verdict(verdict: Callable[[Any, Key], Any], scene: Any, key: Key) -> None:
    """Refuse before the ascents what could not be averaged after them."""
    if not callable(verdict):
        raise TypeError(f"verdict: got {type(verdict).__name__}, want a function of scene, key")
    for leaf in jax.tree.leaves(jax.eval_shape(verdict, scene, key)):
        check_array("verdict", leaf, shape=())


def _check_bounds(low: Any, high: Any) -> tuple[Any, Any]:
    if jax.tree.structure(low) != jax.tree.structure(high):
        raise ValueError(
            f"high: got the structure {jax.tree.structure(high)}, want that of low, "
            f"{jax.tree.structure(low)}"
        )
    for (path, least), most in zip(
        jax.tree.leaves_with_path(low), jax.tree.leaves(high), strict=True
    ):
        name = f"high{jax.tree_util.keystr(path)}"
        check_array(name, most, shape=jnp.shape(least))
        if not (np.asarray(least) < np.asarray(most)).all():
            raise ValueError(f"{name}: got {most}, want more than low, {least}")
    return jax.tree.map(as_float, low), jax.tree.map(as_float, high)
