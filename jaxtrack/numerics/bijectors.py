"""Bijections between unconstrained reals and constrained parameters, for gradient-based tuning."""

import math
from collections.abc import Callable
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
from jax.typing import ArrayLike

from jaxtrack.numerics.checks import check_array
from jaxtrack.numerics.safe import as_float, safe_log
from jaxtrack.types import Array


class Bijector(NamedTuple):
    """A map from the reals onto a constrained set, and the way back; of arrays, or of pytrees."""

    forward: Callable[[Any], Any]
    inverse: Callable[[Any], Any]


def identity() -> Bijector:
    """Return the bijector of a parameter without constraint.

    Example:
        >>> float(identity().forward(2.0))
        2.0
    """
    return Bijector(forward=as_float, inverse=as_float)


def positive() -> Bijector:
    """Return the bijector u ↦ exp u onto the positive numbers.

    The exponential and not the softplus, because positive parameters here are scales (deviations,
    rates, tolerances) that span decades: a step in u is then a relative change of the parameter
    wherever it stands, and the gradient in u is the sensitivity to a relative change. A softplus
    is linear above 1, so the same step would mean 100 % for one unit and nothing for another.

    Example:
        >>> round(float(positive().forward(positive().inverse(0.05))), 6)
        0.05

    Note:
        |u| beyond 42 in float32 and 347 in float64 saturates with gradient 0: so neither the
        parameter nor its square, a variance, overflows or vanishes. `inverse` takes what is below
        this range, 0 included, to its lower end.
    """

    def forward(u: ArrayLike) -> Array:
        u = as_float(u)
        limit = _log_limit(u)
        u = jnp.where(u > limit, limit, u)
        return jnp.exp(jnp.where(u < -limit, -limit, u))

    def inverse(y: ArrayLike) -> Array:
        y = as_float(y)
        return safe_log(y, floor=math.exp(-_log_limit(y)))

    return Bijector(forward=forward, inverse=inverse)


def bounded(low: ArrayLike, high: ArrayLike) -> Bijector:
    """Return the bijector u ↦ low + (high − low) / (1 + exp(−u)) onto an interval.

    Args:
        low: lower bound, in the parameter's unit.
        high: upper bound, greater than `low`.

    Example:
        >>> float(bounded(2.0, 4.0).forward(0.0))
        3.0

    Note:
        For large |u| the value rounds to a bound. `inverse` takes a bound, or what lies beyond it,
        to a large finite number with gradient 0 in the part that vanishes.
    """
    low, high = as_float(low), as_float(high)

    def forward(u: ArrayLike) -> Array:
        u = as_float(u)
        # The weighted mean meets both bounds exactly, which low + (high − low) s may miss.
        return low * jax.nn.sigmoid(-u) + high * jax.nn.sigmoid(u)

    def inverse(y: ArrayLike) -> Array:
        y = as_float(y)
        return safe_log(y - low) - safe_log(high - y)

    return Bijector(forward=forward, inverse=inverse)


def simplex() -> Bijector:
    """Return the bijector from R^{n−1} onto the n positive numbers that sum to 1.

        p = softmax(u₁, …, u_{n−1}, 0),    u_i = log p_i − log p_n.

    The last logit is fixed, because the softmax of n free ones does not change when all of them
    move together: such a direction has no gradient and no inverse.

    Example:
        >>> simplex().forward(jnp.zeros(1)).tolist()
        [0.5, 0.5]
        >>> simplex().inverse(jnp.array([0.25, 0.25, 0.5])).shape
        (2,)

    Raises:
        ValueError: (from the two maps) the argument is not one-dimensional.

    Note:
        `inverse` takes a probability of 0 to a large finite logit.
    """

    def forward(u: ArrayLike) -> Array:
        check_array("u", u, shape=("n - 1",))
        u = as_float(u)
        return jax.nn.softmax(jnp.concatenate([u, jnp.zeros(1, dtype=u.dtype)]))

    def inverse(y: ArrayLike) -> Array:
        check_array("y", y, shape=("n",))
        log_probability = safe_log(y)
        return log_probability[:-1] - log_probability[-1]

    return Bijector(forward=forward, inverse=inverse)


def bijector_of(tree: Any) -> Bijector:
    """Return the bijector of a whole pytree of parameters from those of its parts.

    Args:
        tree: bijectors in the parameters' structure. One that stands where the parameters branch
            is that of every leaf below it, so a single bijector is a tree too.

    Raises:
        ValueError: (from the two maps) the parameters branch otherwise, or are refused by a part.
        TypeError: a leaf is no bijector.

    Example:
        >>> both = bijector_of({"sigma_m": positive(), "p_detect": bounded(0.0, 1.0)})
        >>> free = both.inverse({"sigma_m": 1.0, "p_detect": 0.5})
        >>> print(free["sigma_m"], free["p_detect"])
        0.0 0.0
    """
    is_bijector = lambda x: isinstance(x, Bijector)
    for leaf in jax.tree.leaves(tree, is_leaf=is_bijector):
        if not is_bijector(leaf):
            raise TypeError(f"bijectors: got {type(leaf).__name__}, want a pytree of Bijector")

    def over(direction: str, values: Any) -> Any:
        def part(bijector: Bijector, below: Any) -> Any:
            return jax.tree.map(getattr(bijector, direction), below)

        try:
            return jax.tree.map(part, tree, values, is_leaf=is_bijector)
        except ValueError as error:
            got = jax.tree.structure(tree, is_leaf=is_bijector)
            want = f"ones that fit parameters of {jax.tree.structure(values)}"
            raise ValueError(f"bijectors: got {got}, want {want}: {error}") from error

    return Bijector(lambda u: over("forward", u), lambda y: over("inverse", y))


def _log_limit(x: Array) -> float:
    """Return the largest |log y| such that y² is surely a normal number of the dtype."""
    return -0.49 * math.log(float(jnp.finfo(x.dtype).tiny))
