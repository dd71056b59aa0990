"""What the filters of the Kalman family share: Gaussian moments, their two steps, and the loop.

Motion and measurement reach the two steps as matrices. A linear model is its own matrix; the
extended and the unscented filter find the matrix of a function near a density, and the covariance
`excess` of what it misses (`Linear`). So all of them are one recursion and one smoother.
"""

import math
from collections.abc import Callable
from typing import Any, NamedTuple, TypeVar

import jax
import jax.numpy as jnp

from jaxtrack.numerics.checks import check_array
from jaxtrack.numerics.definite import rounding_floor, scaled_root
from jaxtrack.numerics.safe import as_float
from jaxtrack.types import Array, Estimator

TreeT = TypeVar("TreeT")


class Moments(NamedTuple):
    """Mean and covariance of a state."""

    mean: Array  # [S]
    covariance: Array  # [S, S]


class Prior(NamedTuple):
    """What is known of the state before the first look."""

    mean: Array  # [S]
    covariance: Array  # [S, S]
    time_s: Array | float = 0.0  # [] when it holds; the first look is predicted from there


class Update(NamedTuple):
    """A state after a measurement, and how the measurement agreed with it."""

    mean: Array  # [S]
    covariance: Array  # [S, S]
    innovation: Array  # [Z]
    innovation_covariance: Array  # [Z, Z]
    log_likelihood: Array  # [] log N(innovation; 0, innovation_covariance)
    definite: Array  # [] False: the innovation's covariance was singular beyond rounding


class Linear(NamedTuple):
    """A function near a density: f(x) = value + matrix (x − mean) + e, cov(e) = excess."""

    value: Array  # [Z]
    matrix: Array  # [Z, S]
    excess: Array  # [Z, Z]


class Seen(NamedTuple):
    """What a look says about one target, without NaN also where it says nothing."""

    mask: Array  # [] False: the target was not seen
    innovation: Array  # [Z]
    matrix: Array  # [Z, S]
    noise: Array  # [Z, Z]


class FilterState(NamedTuple):
    """What the next look needs."""

    time_s: Array  # []
    mean: Array  # [S]
    covariance: Array  # [S, S]


class FilterInfo(NamedTuple):
    """What a look did. Stacked, it is what `smoother.smooth` takes."""

    seen: Array  # []
    predicted: Moments
    filtered: Moments
    transition: Array  # [S, S] from the look before to this one
    noise: Array  # [S, S] what was added to the covariance on that way
    innovation: Array  # [Z] 0 where unseen
    innovation_covariance: Array  # [Z, Z]
    log_likelihood: Array  # [] 0 where unseen
    definite: Array  # [] False: numerical trouble, see `Update`


def symmetric(matrix: Array) -> Array:
    """Return the symmetric part: products keep symmetry up to rounding, which adds up over steps.

    Example:
        >>> print(symmetric(jnp.array([[1.0, 2.0], [4.0, 3.0]])))
        [[1. 3.]
         [3. 3.]]
    """
    return (matrix + matrix.T) / 2


def predict(mean: Array, covariance: Array, transition: Array, noise: Array) -> Moments:
    """Move a state by a linear motion.

        m⁻ = F m,   P⁻ = F P Fᵀ + Q

    Args:
        mean: [S].
        covariance: [S, S].
        transition: [S, S] F.
        noise: [S, S] Q.

    Example:
        >>> moved = predict(jnp.array([1.0]), jnp.eye(1), 2 * jnp.eye(1), 3 * jnp.eye(1))
        >>> print(moved.mean, moved.covariance)
        [2.] [[7.]]
    """
    check_array("transition", transition, shape=(*jnp.shape(mean), *jnp.shape(mean)))
    return Moments(transition @ mean, predicted_covariance(covariance, transition, noise))


def predicted_covariance(covariance: Array, transition: Array, noise: Array) -> Array:
    """Return F P Fᵀ + Q, [S, S].

    Example:
        >>> print(predicted_covariance(jnp.eye(1), 2 * jnp.eye(1), 3 * jnp.eye(1)))
        [[7.]]
    """
    return symmetric(transition @ covariance @ transition.T + noise)


def correct(
    mean: Array, covariance: Array, innovation: Array, matrix: Array, noise: Array
) -> Update:
    """Take an innovation in, in Joseph's form: a sum of squares, which rounding keeps positive.

        S = H P Hᵀ + R,   K = P Hᵀ S⁻¹,   m' = m + K y,   P' = (I − K H) P (I − K H)ᵀ + K R Kᵀ,
        log-likelihood = −½ (yᵀ S⁻¹ y + log det 2πS)

    Args:
        mean: [S] predicted.
        covariance: [S, S] predicted.
        innovation: [Z] y, measured minus expected; the caller wraps angles.
        matrix: [Z, S] H.
        noise: [Z, Z] R.

    Raises:
        ValueError: shapes do not fit together.

    Example:
        >>> after = correct(jnp.zeros(1), jnp.eye(1), jnp.ones(1), jnp.eye(1), 3 * jnp.eye(1))
        >>> print(after.mean, after.covariance, after.innovation_covariance)
        [0.25] [[0.75]] [[4.]]
    """
    (size,), (places,) = jnp.shape(mean), jnp.shape(innovation)
    check_array("covariance", covariance, shape=(size, size))
    check_array("matrix", matrix, shape=(places, size))
    check_array("noise", noise, shape=(places, places))
    cross = covariance @ matrix.T
    seen = matrix @ cross
    spread = symmetric(seen + noise)
    root, definite = scaled_root(spread, floor=rounding_floor(spread))
    white = (root * innovation[None, :]).sum(1)
    gain = _product(cross, _product(root.T, root))
    # (I − K H) P (I − K H)ᵀ from the left and then from the right, with H P at hand.
    left = covariance - _product(gain, cross.T)
    both = left - _product(cross - _product(gain, seen), gain.T)
    after = symmetric(both + _product(_product(gain, noise), gain.T))
    half_log_determinant = -jnp.log(jnp.diagonal(root)).sum() + places / 2 * math.log(2 * math.pi)
    log_likelihood = -(white @ white) / 2 - half_log_determinant
    moved = mean + (gain * innovation[None, :]).sum(1)
    return Update(moved, after, innovation, spread, log_likelihood, definite)


def begin(prior: Prior) -> FilterState:
    """Return the state before the first look.

    Raises:
        ValueError: mean and covariance do not fit together.

    Example:
        >>> print(begin(Prior(jnp.zeros(4), jnp.eye(4))).time_s)
        0.0
    """
    check_array("prior.mean", prior.mean, shape=("S",))
    size = jnp.shape(prior.mean)[0]
    check_array("prior.covariance", prior.covariance, shape=(size, size))
    mean = as_float(prior.mean)
    time_s = jnp.asarray(prior.time_s, mean.dtype)
    return FilterState(time_s, mean, jnp.asarray(prior.covariance, mean.dtype))


def elapsed(state_time_s: Array, scan: Any) -> Array:
    """Return the time since the last valid look, 0 where there is no look.

    Example:
        >>> from jaxtrack.types import Scan
        >>> scan = Scan(jnp.array(5.0), jnp.array(True), jnp.zeros((1, 2)), jnp.array([True]))
        >>> print(elapsed(jnp.array(2.0), scan))
        3.0
    """
    return jnp.where(scan.valid, scan.time_s - state_time_s, 0.0)


def choose(condition: Array, yes: TreeT, no: TreeT) -> TreeT:
    """Return one of two trees of arrays.

    Example:
        >>> print(choose(jnp.array(False), (jnp.ones(1),), (jnp.zeros(1),))[0])
        [0.]
    """
    return jax.tree.map(lambda a, b: jnp.where(condition, a, b), yes, no)


def recursion(
    prior: Prior,
    move: Callable[[Array, Array, Array], Linear],
    observe: Callable[[Array, Array, Any], Seen],
) -> Estimator[Any, FilterState, FilterInfo]:
    """Return the filter of one target that is seen at most once a look.

    A look without the target only moves the state on. Where there is no look (`valid` False)
    nothing happens, and the next one is predicted from the last valid one; what stands in it,
    its time included, may be anything.

    Args:
        prior: the state before the first look.
        move: (mean, covariance, dt_s) → the motion near that density, its noise in `excess`.
        observe: (mean, covariance, scan) → what the scan says of a state with that density.

    Example:
        >>> from jaxtrack.filtering.kalman import KalmanParams, kalman  # is made by it
        >>> filter = kalman(KalmanParams(Prior(jnp.zeros(4), jnp.eye(4)), 0.1, 10.0))
        >>> print(filter.init(jax.random.key(0)).mean)
        [0. 0. 0. 0.]
    """

    def init(key: Array) -> FilterState:
        return begin(prior)

    def step(state: FilterState, scan: Any) -> tuple[FilterState, FilterInfo]:
        before = Moments(state.mean, state.covariance)
        motion = move(*before, elapsed(state.time_s, scan))
        covariance = predicted_covariance(state.covariance, motion.matrix, motion.excess)
        stay = jnp.eye(state.mean.shape[0], dtype=state.mean.dtype)
        predicted, transition, noise = choose(
            scan.valid,
            (Moments(motion.value, covariance), motion.matrix, motion.excess),
            (before, stay, jnp.zeros_like(stay)),
        )
        seen = observe(*predicted, scan)
        after = correct(*predicted, seen.innovation, seen.matrix, seen.noise)
        filtered = choose(seen.mask, Moments(after.mean, after.covariance), predicted)
        info = FilterInfo(
            seen.mask,
            predicted,
            filtered,
            transition,
            noise,
            jnp.where(seen.mask, after.innovation, 0.0),
            after.innovation_covariance,
            jnp.where(seen.mask, after.log_likelihood, 0.0),
            after.definite | ~seen.mask,
        )
        return FilterState(jnp.where(scan.valid, scan.time_s, state.time_s), *filtered), info

    return Estimator(init, step)


def _product(a: Array, b: Array) -> Array:
    """Return A B written out: batches of small products run as plain arithmetic, several fused."""
    return sum(
        (a[:, k, None] * b[None, k, :] for k in range(1, a.shape[1])), a[:, 0, None] * b[None, 0, :]
    )
