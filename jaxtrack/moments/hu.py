"""Hu's seven moment invariants of weighted points."""

import jax
import jax.numpy as jnp

from jaxtrack.moments.totals import totals
from jaxtrack.moments.window import check_points
from jaxtrack.types import Array


def hu(xy: Array, weight: Array) -> Array:
    """Return Hu's invariants, [7], of the central moments of all points.

        μ_pq = Σ w (x − x̄)^p (y − ȳ)^q,   η_pq = μ_pq / μ_00^(1 + (p + q)/2)

    and, with a = η30 + η12, b = η21 + η03, c = η30 − 3η12, d = 3η21 − η03, e = η20 − η02,

        I1 = η20 + η02            I2 = e² + 4η11²    I3 = c² + d²    I4 = a² + b²
        I5 = c a (a² − 3b²) + d b (3a² − b²)         I6 = e (a² − b²) + 4η11 a b
        I7 = d a (a² − 3b²) − c b (3a² − b²)

    They stay where points are moved or turned; mirrored, I7 changes its sign. They stay under a
    change of scale if a weight is a value times the area ΔA that its point stands for, in the unit
    of the points squared: then they do not depend on how densely the points stand either. Without
    ΔA they do. Places times s make I1 to I7 s², s⁴, s⁶, s⁶, s¹², s⁸ and s¹² times as large, weights
    times s² undo that. Without weight, and of a single place, they are zero.

    Args:
        xy: [P, 2].
        weight: [P], for invariance to scale in the unit of `xy` squared; a point with a weight that
            is not positive and finite, or not at a finite place, is none.

    Raises:
        ValueError: shapes do not fit.
        TypeError: not real numbers.

    Example:
        >>> xy = jnp.array([[0.0, 0.0], [0.0, 1.0], [1.0, 0.0], [1.0, 1.0]])
        >>> for step in (1.0, 10.0):
        ...     print(hu(step * xy, step**2 * jnp.ones(4)).round(4))
        [0.125 0.    0.    0.    0.    0.    0.   ]
        [0.125 0.    0.    0.    0.    0.    0.   ]

    Source: M.-K. Hu, "Visual pattern recognition by moment invariants" (1962); the seven features
        that Zernike moment feature matching (2023), section 2.3.1, compares with.

    Note:
        Small shapes have small invariants: below 1e-38 single precision has only zero. What would
        come near its 3e38 stays at some 1e31, without slope.
    """
    xy, weight = check_points(xy, weight)
    there = jnp.isfinite(xy).all(-1) & (weight > 0) & jnp.isfinite(weight)
    x, y = (jnp.where(there, xy[:, axis], 0.0) for axis in (0, 1))
    weight = jnp.where(there, weight, 0.0)
    mass = weight.sum()
    some = mass > jnp.finfo(xy.dtype).tiny
    # The gradient runs through the mass in units of itself, as in `zernike`.
    scale = jax.lax.stop_gradient(jnp.where(some, 1 / jnp.where(some, mass, 1.0), 0.0))
    weight = weight * scale
    mass = jnp.where(some, mass * scale, 1.0)
    mean_x, mean_y = (total / mass for total in totals(weight * x, weight * y))
    # η_pq is the mean of (x − x̄)^p (y − ȳ)^q in units of the root of the mass.
    unit = jnp.sqrt(jnp.where(some, scale / mass, 1.0))
    x, y = unit * (x - mean_x), unit * (y - mean_y)
    square = x * x + y * y
    even, odd = x * x - y * y, 2 * x * y  # the parts of z²
    terms = square, even, odd, square * x, square * y, even * x - odd * y, even * y + odd * x
    # Of z = x + jy these are the means of |z|², z², |z|² z and z³.
    # Four are multiplied, and what is left of the range is the gradients'.
    most = (1e-8 * float(jnp.finfo(xy.dtype).max)) ** 0.25
    spread, e, twist, a, b, c, d = (
        jnp.clip(total / mass, -most, most) for total in totals(*(weight * term for term in terms))
    )
    # a − jb squared and cubed.
    square_real, square_imaginary = a * a - b * b, -2 * a * b
    cube_real = square_real * a + square_imaginary * b
    cube_imaginary = square_imaginary * a - square_real * b
    return jnp.stack(
        [
            spread,
            e * e + twist * twist,
            c * c + d * d,
            a * a + b * b,
            c * cube_real - d * cube_imaginary,
            e * square_real - twist * square_imaginary,
            c * cube_imaginary + d * cube_real,
        ]
    )
