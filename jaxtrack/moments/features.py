"""Features of moments: their magnitudes on a logarithmic scale, on which they compare."""

import math

import jax.numpy as jnp

from jaxtrack.numerics.checks import check_known
from jaxtrack.types import Array


def log_features(moments: Array) -> Array:
    """Return the magnitudes of moments as the paper compares them.

        F = |lg |I||

    Args:
        moments: real or complex, any shape. Zero counts as the smallest normal number.

    Example:
        >>> print(log_features(jnp.array([0.01, -100.0])))
        [2. 2.]

    Source: Zernike moment feature matching (2023), equation 26.

    Note:
        It folds where |I| = 1, and has no gradient to go by at zero. Use `soft_log_features` for
        one.
    """
    size = jnp.abs(jnp.asarray(moments))
    tiny = jnp.finfo(size.dtype).tiny
    return jnp.abs(jnp.log10(jnp.where(size > tiny, size, tiny)))


def soft_log_features(moments: Array, eps: Array | float) -> Array:
    """Return the magnitudes of moments on a logarithmic scale, differentiable everywhere.

        ½ lg(|I|² + ε)

    Tends to lg |I| as ε vanishes: minus `log_features` where |I| < 1, and not folded at 1.

    Args:
        moments: real or complex, any shape.
        eps: ε > 0, in the unit of the moments squared. It hides what is below its root: Hu's
            invariants reach 1e-20, which asks for 1e-40 and so for double precision. The smallest
            normal number of the dtype is the least it acts as.

    Raises:
        ValueError: a known ε that is not positive.

    Example:
        >>> print(soft_log_features(jnp.array([10.0, 0.0]), 1e-12).round(2))
        [ 1. -6.]
    """
    check_known("eps", eps, lambda x: (x > 0) & (x < math.inf), "a positive, finite number")
    moments = jnp.asarray(moments)
    square = moments.real**2 + moments.imag**2
    tiny = jnp.finfo(square.dtype).tiny
    eps = jnp.asarray(eps, square.dtype)
    return 0.5 * jnp.log10(square + jnp.where(eps > tiny, eps, tiny))
