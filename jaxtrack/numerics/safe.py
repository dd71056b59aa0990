"""Elementary functions whose value and gradient are finite at their singular points.

Every function hides the singular point from the differentiated branch (the double `where`): a
single `where` around `log(x)` still sends `0 · inf = NaN` backwards. NaN arguments stay NaN.
"""

import math

import jax
import jax.numpy as jnp
from jax.typing import ArrayLike

from jaxtrack.types import Array


def as_float(x: ArrayLike) -> Array:
    """Return `x` as a floating array: floats keep their dtype, the rest takes the default one.

    Example:
        >>> jnp.issubdtype(as_float(jnp.arange(3)).dtype, jnp.floating)
        True
    """
    # A Python int becomes a Python float first, for only Python scalars leave the other operand's
    # dtype alone.
    array = jnp.asarray(float(x) if isinstance(x, int) else x)
    return array if jnp.issubdtype(array.dtype, jnp.floating) else array.astype(float)


def safe_sqrt(x: ArrayLike) -> Array:
    """Square root that is 0 with gradient 0 wherever x ≤ 0.

    Args:
        x: any shape.

    Example:
        >>> float(jax.grad(safe_sqrt)(0.0))
        0.0
    """
    x = as_float(x)
    nonpositive = x <= 0
    return jnp.where(nonpositive, 0.0, jnp.sqrt(jnp.where(nonpositive, 1.0, x)))


def safe_norm(x: ArrayLike, axis: int = -1) -> Array:
    """Euclidean norm ‖x‖ = √Σ x², with gradient 0 at the zero vector.

    Args:
        x: any shape; the unit is kept.
        axis: the axis that is summed over.

    Example:
        >>> float(safe_norm(jnp.array([3.0, 4.0])))
        5.0
        >>> jax.grad(safe_norm)(jnp.zeros(2)).tolist()
        [0.0, 0.0]
    """
    x = as_float(x)
    return safe_sqrt(jnp.sum(x * x, axis=axis))


def safe_divide(numerator: ArrayLike, denominator: ArrayLike, fallback: ArrayLike = 0.0) -> Array:
    """Quotient that is `fallback` where the denominator is 0, or below the dtype's normal numbers.

    There the gradient with respect to numerator and denominator is 0. Elsewhere it is made without
    the denominator's square, so that it is finite where the two are tiny alike.

    Args:
        numerator: any shape.
        denominator: a shape that broadcasts with it.
        fallback: the value where there is no quotient.

    Example:
        >>> safe_divide(jnp.array([1.0, 1.0]), jnp.array([2.0, 0.0]), fallback=7.0).tolist()
        [0.5, 7.0]
        >>> print(f"{jax.grad(safe_divide, 1)(1e-30, 1e-30):.0e}")
        -1e+30
    """
    denominator = as_float(denominator)
    zero = jnp.abs(denominator) < jnp.finfo(denominator.dtype).tiny
    return jnp.where(
        zero, fallback, _quotient(as_float(numerator), jnp.where(zero, 1.0, denominator))
    )


@jax.custom_jvp
def _quotient(numerator: Array, denominator: Array) -> Array:
    return numerator / denominator


@_quotient.defjvp
def _quotient_jvp(at: tuple[Array, Array], along: tuple[Array, Array]) -> tuple[Array, Array]:
    quotient = _quotient(*at)
    return quotient, _tiny_alike(along[0] - quotient * along[1], at[1])


def _tiny_alike(numerator: Array, denominator: Array) -> Array:
    """Return a quotient whose gradient squares no denominator.

    That of `/` does, which below 1e-19 single precision cannot hold.
    """
    unit = jax.lax.stop_gradient(1 / denominator)
    return numerator * unit / (denominator * unit)


def safe_log(x: ArrayLike, floor: ArrayLike | None = None) -> Array:
    """Natural logarithm that is log(floor) with gradient 0 wherever x ≤ floor.

    Args:
        x: any shape.
        floor: a positive number; by default the smallest normal number of the dtype, so that
            the result is about −87 in float32 and −708 in float64 where x ≤ 0.

    Example:
        >>> bool(jnp.isfinite(safe_log(0.0)))
        True
        >>> float(jax.grad(safe_log)(0.0))
        0.0
    """
    x = as_float(x)
    lowest = jnp.asarray(jnp.finfo(x.dtype).tiny if floor is None else floor, dtype=x.dtype)
    low = x <= lowest
    return jnp.where(low, jnp.log(lowest), _log(jnp.where(low, 1.0, x)))


@jax.custom_jvp
def _log(x: Array) -> Array:
    return jnp.log(x)


@_log.defjvp
def _log_jvp(at: tuple[Array], along: tuple[Array]) -> tuple[Array, Array]:
    return _log(*at), _tiny_alike(*along, *at)


def safe_arctan2(y: ArrayLike, x: ArrayLike) -> Array:
    """Angle of (x, y) in [−π, π], radians; 0 with gradient 0 at the origin.

    Args:
        y: any shape.
        x: the same shape and unit.

    Example:
        >>> float(safe_arctan2(0.0, 0.0))
        0.0
        >>> float(jax.grad(safe_arctan2)(0.0, 0.0))
        0.0

    Note:
        The gradient divides by r² = x² + y², so all of r² below the smallest normal number of
        the dtype counts as the origin, not only r = 0.
    """
    y, x = as_float(y), as_float(x)
    square = x * x + y * y
    origin = square < jnp.finfo(square.dtype).tiny
    return jnp.arctan2(jnp.where(origin, 0.0, y), jnp.where(origin, 1.0, x))


def safe_sinc(x: ArrayLike) -> Array:
    """Return sin(x)/x, 1 at zero, with derivatives that keep their precision near zero.

    Args:
        x: any shape, radians.

    Example:
        >>> [round(float(safe_sinc(x)), 4) for x in (0.0, jnp.pi / 2)]
        [1.0, 0.6366]
        >>> round(float(jax.grad(jax.grad(safe_sinc))(0.0)), 4)
        -0.3333

    Note:
        Below ½ it is its series: there the derivative of the quotient is a difference of two large
        numbers, cos(x)/x − sin(x)/x².
    """
    x = as_float(x)
    near = jnp.abs(x) < 0.5
    square = jnp.where(near, x, 0.0) ** 2
    series = jnp.ones_like(x)
    for k in range(14, 0, -2):  # the next term is below 0.5¹⁶ / 17!, which float64 cannot see
        series = 1 - square * series / (k * (k + 1))
    far = jnp.where(near, 1.0, x)
    return jnp.where(near, series, jnp.sin(far) / far)


def safe_min(x: ArrayLike, axis: int = -1) -> Array:
    """Minimum along an axis; the gradient goes to the first minimal entry alone.

    Args:
        x: any shape, at least one entry along `axis`.
        axis: the axis that is reduced.

    Example:
        >>> jax.grad(safe_min)(jnp.array([2.0, 1.0, 1.0])).tolist()
        [0.0, 1.0, 0.0]

    Note:
        Use it instead of `x.min()` in everything that is differentiated: the CPU compiler gives
        finite but wrong gradients for some jitted programs that reduce with `min` or `max`.
    """
    x = jnp.asarray(x)
    return take_along(x, jnp.argmin(jax.lax.stop_gradient(x), axis=axis), axis)


def safe_max(x: ArrayLike, axis: int = -1) -> Array:
    """Maximum along an axis; the gradient goes to the first maximal entry alone.

    Args:
        x: any shape, at least one entry along `axis`.
        axis: the axis that is reduced.

    Example:
        >>> jax.grad(safe_max)(jnp.array([1.0, 2.0, 2.0])).tolist()
        [0.0, 1.0, 0.0]

    Note:
        For the reason to prefer it to `x.max()` see `safe_min`.
    """
    x = jnp.asarray(x)
    return take_along(x, jnp.argmax(jax.lax.stop_gradient(x), axis=axis), axis)


def take_along(x: Array, index: Array, axis: int) -> Array:
    """Take one entry along an axis: the counterpart of an arg-reduction.

    Args:
        x: any shape.
        index: the shape of `x` without `axis`; integers.
        axis: the axis that is reduced.

    Example:
        >>> take_along(jnp.array([[1.0, 2.0], [3.0, 4.0]]), jnp.array([1, 0]), -1).tolist()
        [2.0, 3.0]
    """
    taken = jnp.take_along_axis(x, jnp.expand_dims(index, axis), axis=axis)
    return jnp.squeeze(taken, axis=axis)


def wrap_angle(angle_rad: ArrayLike) -> Array:
    """Wrap an angle to [−π, π), with gradient 1 everywhere.

    Args:
        angle_rad: any shape, radians.

    Example:
        >>> round(float(wrap_angle(1.5 * jnp.pi)), 4)
        -1.5708

    Note:
        π is the dtype's nearest number to it. Angles already inside come back bit for bit, so
        small innovations keep their relative precision.
    """
    angle_rad = as_float(angle_rad)
    inside = (angle_rad >= -math.pi) & (angle_rad < math.pi)
    wrapped = jnp.mod(angle_rad + math.pi, 2 * math.pi) - math.pi
    # A remainder just below 2π may round up to it, which would give +π.
    wrapped = jnp.where(wrapped >= math.pi, wrapped - 2 * math.pi, wrapped)
    return jnp.where(inside, angle_rad, wrapped)
