"""Which points count: discs, hard and soft, and the points around each of many centres."""

from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from jaxtrack.numerics.checks import check_array, check_known, check_positive, check_size
from jaxtrack.numerics.safe import as_float
from jaxtrack.types import Array, Scan


class Windows(NamedTuple):
    """The points in a disc around each of N centres."""

    xy: Array  # [N, M, 2] from the centre; finite
    weight: Array  # [N, M] zero where no point is in the disc
    overflow: Array  # [] more points lay around the centres than there are places


def inside(xy: Array, weight: Array, *, radius: Array | float) -> tuple[Array, Array]:
    """Return points [P, 2] that are finite, and weights [P] that are zero outside a disc.

    The disc is about the origin, its edge belongs to it. A point with a weight that is not positive
    and finite, or with a coordinate that is not finite, is outside.

    Args:
        xy: [P, 2], in the unit of `radius`.
        weight: [P].
        radius: of the disc, > 0.

    Raises:
        ValueError: shapes do not fit, or a radius that cannot be.
        TypeError: not real numbers.

    Example:
        >>> xy, weight = inside(jnp.array([[3.0, 4.0], [4.0, 4.0]]), jnp.ones(2), radius=5.0)
        >>> print(weight)
        [1. 0.]
    """
    xy, weight = check_points(xy, weight)
    radius = check_positive("radius", radius, xy.dtype)
    # The coordinates stay apart: what is stacked in between the compiler does not fuse.
    x, y = xy[:, 0], xy[:, 1]
    counts = _close(x, y, radius) & (weight > 0) & (weight < np.inf)
    # A test of its own for each costs less than one for all three.
    x, y = (jnp.where(jnp.abs(part) <= radius, part, 0.0) for part in (x, y))
    return jnp.stack([x, y], axis=-1), jnp.where(counts, weight, 0.0)


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

    Points that are near no centre are dropped, which is what makes many windows on a large cloud
    cheap: what follows costs N × M, not N × P. The M places are those of all points near
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
    there = jnp.isfinite(xy).all(-1) & (weight > 0) & (weight < np.inf)
    x, y, weight = (jnp.where(there, part, 0.0) for part in (xy[:, 0], xy[:, 1], weight))
    known = jnp.isfinite(centres).all(-1)
    centres = jnp.where(known[:, None], centres, 0.0)

    def look(near: Array, centre: Array) -> tuple[Array, None]:
        return near | _close(x - centre[0], y - centre[1], radius), None

    nothing = jnp.zeros(there.shape, bool)
    near, _ = jax.lax.scan(look, nothing, jax.lax.stop_gradient(centres), unroll=8)
    near = near & there
    order = jnp.arange(x.shape[0], dtype=jnp.int32)
    place = jnp.where(near, jnp.cumsum(near.astype(jnp.int32)) - 1, places)
    index = jnp.zeros(places, jnp.int32).at[place].set(order, mode="drop")
    count = near.sum(dtype=jnp.int32)
    weight = jnp.where(order[:places] < count, weight[index], 0.0)
    x, y = (
        at[index][None, :] - centre[:, None]
        for at, centre in ((x, centres[:, 0]), (y, centres[:, 1]))
    )
    counts = _close(x, y, radius) & known[:, None]
    return Windows(
        jnp.stack([x, y], axis=-1), jnp.where(counts, weight[None, :], 0.0), count > places
    )


def cloud_windows(cloud: Scan, centres_m: Array, *, radius_m: Array | float, most: int) -> Windows:
    """Return the detections of a look within a radius of each of many centres, as `windowed` does.

    Args:
        cloud: a look, with or without weights; what its mask leaves out weighs nothing.
        centres_m: [N, 2].
        radius_m: of the windows, > 0.
        most: places for detections. Static.

    Raises:
        ValueError: shapes do not fit, a radius that cannot be, or no place.
        TypeError: not real numbers, or `most` is not an int.

    Example:
        >>> at = jnp.array([[0.3, 0.0], [jnp.nan, 0.4], [5.0, 0.1]])
        >>> cloud = Scan(jnp.array(0.0), jnp.array(True), at, jnp.array([True, False, True]))
        >>> print(cloud_windows(cloud, jnp.zeros((1, 2)), radius_m=1.0, most=3).weight.sum(1))
        [1.]
    """
    dtype = centres_m.dtype
    weight = cloud.mask.astype(dtype)
    if cloud.weight is not None:
        weight = jnp.where(cloud.mask, cloud.weight, 0.0).astype(dtype)
    places = jnp.where(cloud.mask[:, None], cloud.position_m, 0.0).astype(dtype)
    return windowed(places, weight, centres_m, radius=radius_m, most=most)


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


def _close(x: Array, y: Array, radius: Array) -> Array:
    """Not scaled by the radius, so that points on a lattice are on the edge exactly."""
    return x * x + y * y <= radius * radius
