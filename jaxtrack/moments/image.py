"""Moments of images: their pixels as points."""

import jax.numpy as jnp

from jaxtrack.moments.hu import hu
from jaxtrack.moments.zernike import Orders, zernike
from jaxtrack.numerics.checks import check_array
from jaxtrack.numerics.safe import as_float
from jaxtrack.types import Array


def image_points(image: Array) -> tuple[Array, Array]:
    """Return the places [H W, 2] of the pixels, (column, row), and their values [H W].

    The unit is the pixel, so ΔA = 1 and a value is a weight. Rows run down: angles turn from the
    columns' axis to the rows', clockwise on a screen.

    Args:
        image: [H, W].

    Raises:
        ValueError: not an image.
        TypeError: not real numbers.

    Example:
        >>> xy, weight = image_points(jnp.array([[5.0, 0.0, 7.0]]))
        >>> print(xy[2], weight)
        [2. 0.] [5. 0. 7.]
    """
    check_array("image", image, shape=("H", "W"))
    values = as_float(image)
    height, width = values.shape
    row, column = (jnp.arange(size).astype(values.dtype) for size in (height, width))
    shape = (height, width)
    x = jnp.broadcast_to(column[None, :], shape)
    y = jnp.broadcast_to(row[:, None], shape)
    return jnp.stack([x.ravel(), y.ravel()], axis=-1), values.ravel()


def zernike_image(image: Array, centre: Array, *, orders: Orders, radius: Array | float) -> Array:
    """Return Zernike moments of a disc in an image, complex [len(orders)], as `zernike` does.

    Args:
        image: [H, W]; a pixel of a value that is not positive and finite is none.
        centre: [2] of the disc, (column, row), in pixels.
        orders: (n, m), |m| ≤ n ≤ 40, n − |m| even. Static.
        radius: of the disc, in pixels, > 0.

    Raises:
        ValueError: shapes do not fit, no such order, or a radius that cannot be.
        TypeError: not real numbers, or orders that are not ints.

    Example:
        >>> centre = jnp.array([2.0, 1.0])
        >>> moments = zernike_image(jnp.ones((3, 5)), centre, orders=((0, 0), (1, 1)), radius=1.0)
        >>> print(*(f"{abs(z):.3f}" for z in moments))
        0.318 0.000
    """
    check_array("centre", centre, shape=(2,))
    xy, weight = image_points(image)
    return zernike(xy - jnp.asarray(centre, xy.dtype)[None], weight, orders=orders, radius=radius)


def hu_image(image: Array) -> Array:
    """Return Hu's invariants of an image, [7], as `hu` does of its pixels.

    Args:
        image: [H, W]; a pixel of a value that is not positive and finite is none.

    Raises:
        ValueError: not an image.
        TypeError: not real numbers.

    Example:
        >>> print(hu_image(jnp.ones((2, 2))).round(4))
        [0.125 0.    0.    0.    0.    0.    0.   ]

    Note:
        The same numbers as OpenCV's `HuMoments(moments(image))`.
    """
    return hu(*image_points(image))
