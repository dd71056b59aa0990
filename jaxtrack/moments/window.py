"""Which points count: discs, hard and soft, and the points around each of many centres."""

from typing import NamedTuple

import jax.numpy as jnp
import numpy as np

from jaxtrack.numerics.checks import check_array, check_known, check_positive, check_size
from jaxtrack.numerics.safe import as_float
from jaxtrack.types import Array


class Windows(NamedTuple):
    """The points in a disc around each of N centres."""

    xy: Array  # [N, M, 2] from the centre; zero where there is no point
    weight: Array  # [N, M] zero where there is no point
    overflow: Array  # [] more points lay around the centres than there are places


def inside(xy: Array, weight: Array, *, radius: Array | float) -> tuple[Array, Array]:
    """Return points and weights [P] that are zero outside a disc about the origin.

    The edge belongs to the disc. A point with a weight that is not positive and finite, or with a
    coordinate that is not finite, is outside.

    Args:
        xy: [P, 2], in the unit of `radius`.
        weight: [P].
        radius: of the disc, > 0.

    Raises:
        ValueError: shapes do not fit, or a radius that cannot be.
        TypeError: not real numbers.

    Example:
        >>> xy, weight = inside(jnp.array([[3.0, 4.0], [4.0, 4.0]]), jnp.ones(2), radius=5.0)
        >>> print(xy.ravel(), weight)
        [3. 4. 0. 0.] [1. 0.]
    """
    xy, weight = check_points(xy, weight)
    radius = check_positive("radius", radius, xy.dtype)
    # Not scaled by the radius, so that points on a lattice are on the edge exactly.
    square = xy[:, 0] ** 2 + xy[:, 1] ** 2
    counts = (square <= radius * radius) & _there(weight)
    return jnp.where(counts[:, None], xy, 0.0), jnp.where(counts, weight, 0.0)


def soft_inside(
    xy: Array, weight: Array, *, radius: Array | float, taper: Array | float
) -> tuple[Array, Array]:
    """Return points and weights [P] that fade to zero towards the edge of a disc.

        w s² (3 − 2s),   s = (1 − ρ²) / (1 − (1 − τ)²),   from 1 at ρ ≤ 1 − τ to 0 at ρ = 1

    Tends to `inside` as τ vanishes. A point that crosses the edge changes nothing abruptly, and no
    gradient.

    Args:
        xy: [P, 2], in the unit of `radius`.
        weight: [P].
        radius: of the disc, > 0.
        taper: τ, the share of the radius over which points fade, in (0, 1].

    Raises:
        ValueError: shapes do not fit, or a radius or taper that cannot be.
        TypeError: not real numbers.

    Example:
        >>> xy = jnp.array([[2.0, 0.0], [3.0, 0.0], [4.0, 0.0]])
        >>> print(soft_inside(xy, jnp.ones(3), radius=4.0, taper=0.5)[1].round(3))
        [1.    0.624 0.   ]
    """
    xy, weight = inside(xy, weight, radius=radius)
    check_known("taper", taper, lambda x: x <= 1, "a number from 0 to 1")
    taper = check_positive("taper", taper, xy.dtype)
    taper = jnp.where(taper < 1, taper, 1.0)
    radius = check_positive("radius", radius, xy.dtype)
    square = (xy / radius) ** 2
    s = (1 - square[:, 0] - square[:, 1]) / (taper * (2 - taper))
    # Rounding may put a point of the disc a little beyond its edge.
    s = jnp.where(s > 0, jnp.where(s < 1, s, 1.0), 0.0)
    return xy, weight * (s * s * (3 - 2 * s))


def windowed(
    xy: Array, weight: Array, centres: Array, *, radius: Array | float, most: int
) -> Windows:
    """Return the points within a radius of each of many centres.

    Points that are near no centre are dropped first, which is what makes many windows on a large
    cloud cheap: all that follows costs N × M, not N × P. The M places are those of all points near
    any centre, shared by the windows, so M has to hold their union. While it does, what comes out
    of a window is what `inside` gives for all points moved by its centre, but for the zeros.

    Args:
        xy: [P, 2].
        weight: [P]; a point with a weight that is not positive and finite is none.
        centres: [N, 2], in the unit of `xy`.
        radius: of the windows, in the unit of `xy`, > 0.
        most: M, places for points. Static.

    Returns:
        Windows for `jax.vmap(zernike)`, `jax.vmap(hu)`. With `overflow` the last points are left
        out, and windows may lack them.

    Raises:
        ValueError: shapes do not fit, a radius that cannot be, or no place.
        TypeError: not real numbers, or `most` is not an int.

    Example:
        >>> xy = jnp.array([[0.0, 0.0], [9.0, 9.0], [1.0, 0.0]])
        >>> windows = windowed(xy, jnp.ones(3), jnp.array([[0.0, 0.5], [1.5, 0.0]]), radius=1.0,
        ...                    most=2)
        >>> print(windows.weight, windows.overflow)
        [[1. 0.]
         [0. 1.]] False
    """
    xy, weight = check_points(xy, weight)
    check_array("centres", centres, shape=("N", 2))
    centres = jnp.asarray(centres, xy.dtype)
    radius = check_positive("radius", radius, xy.dtype)
    places = min(check_size("most", most), xy.shape[0])
    there = _there(weight)
    x, y = xy[None, :, 0] - centres[:, None, 0], xy[None, :, 1] - centres[:, None, 1]
    near = (x * x + y * y <= radius * radius).any(0) & there
    count = jnp.cumsum(near.astype(jnp.int32))
    order = jnp.arange(xy.shape[0], dtype=jnp.int32)
    index = jnp.zeros(places, jnp.int32)
    index = index.at[jnp.where(near, count - 1, places)].set(order, mode="drop")
    held = order[:places] < near.sum(dtype=jnp.int32)
    offset = xy[index][None] - centres[:, None, :]
    square = offset[..., 0] ** 2 + offset[..., 1] ** 2
    counts = (square <= radius * radius) & held[None, :]
    return Windows(
        jnp.where(counts[..., None], offset, 0.0),
        jnp.where(counts, weight[index][None], 0.0),
        near.sum(dtype=jnp.int32) > places,
    )


def check_points(xy: Array, weight: Array) -> tuple[Array, Array]:
    """Return points in the plane and their weights as arrays of one floating dtype.

    Raises:
        ValueError: shapes do not fit.
        TypeError: not real numbers.

    Example:
        >>> xy, weight = check_points(jnp.zeros((4, 2)), jnp.ones(4, bool))
        >>> print(weight)
        [1. 1. 1. 1.]
    """
    check_array("xy", xy, shape=("P", 2))
    check_array("weight", weight, shape=(jnp.shape(xy)[0],))
    xy = as_float(xy)
    return xy, jnp.asarray(weight).astype(xy.dtype)


def _there(weight: Array) -> Array:
    return (weight > 0) & (weight < np.inf)
