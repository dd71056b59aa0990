"""What OSPA and GOSPA share: the distances between two finite sets, cut off and raised to a power.

`distances_over_time` has them of every look of two sets of tracks.

Everything here is in units of the cut-off c: (min(c, d) / c)^p lies in [0, 1] whatever the order p,
so that neither large distances nor high orders overflow in float32.
"""

from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from jaxtrack.numerics.checks import check_array, check_known
from jaxtrack.numerics.safe import safe_norm
from jaxtrack.types import Array


class CutoffCosts(NamedTuple):
    """The cost of every pair, and the arguments it was made with, cast to one dtype.

    A set without any row has got a masked one, so that M ≥ 1 and N ≥ 1.
    """

    cost: Array  # [M, N]  (min(c, d) / c)^p; of pairs with a masked member: finite, without meaning
    estimates_mask: Array  # [M] bool
    truths_mask: Array  # [N] bool
    cutoff: Array  # []
    order: Array  # []


def safe_power(base: Array, exponent: Array) -> Array:
    """Raise base ≥ 0 to a positive power, with gradient zero at base 0.

    Args:
        base: anything not negative, any shape.
        exponent: positive, a scalar or of the shape of `base`.

    Returns:
        base^exponent. Below the smallest normal number the base counts as zero, for there the
        slope of a root overflows.

    Example:
        >>> safe_power(jnp.asarray([0.0, 4.0]), jnp.asarray(0.5)).tolist()
        [0.0, 2.0]
    """
    positive = base > jnp.finfo(base.dtype).tiny
    return jnp.where(positive, jnp.where(positive, base, 1.0) ** exponent, 0.0)


def cutoff_costs(
    estimates: Array,
    estimates_mask: Array,
    truths: Array,
    truths_mask: Array,
    *,
    cutoff: Any,
    order: Any,
) -> CutoffCosts:
    """Compute (min(c, ‖x − y‖) / c)^p for every pair of an estimate x and a truth y.

    Args:
        estimates: [M, D] points, in the unit of `cutoff`.
        estimates_mask: [M] which of them exist.
        truths: [N, D] points, in the unit of `cutoff`.
        truths_mask: [N] which of them exist.
        cutoff: c > 0, a scalar.
        order: p ≥ 1, a scalar, not necessarily whole.

    Raises:
        ValueError: shapes do not fit.
        TypeError: not real numbers.

    Example:
        >>> point, there = jnp.zeros((1, 2)), jnp.ones(1, bool)
        >>> cutoff_costs(point, there, point + 3.0, there, cutoff=1.0, order=2.0).cost.tolist()
        [[1.0]]
    """
    plain = cutoff_distances(
        estimates, estimates_mask, truths, truths_mask, cutoff=cutoff, order=order
    )
    return plain._replace(cost=safe_power(plain.cost, plain.order))


def cutoff_distances(
    estimates: Array,
    estimates_mask: Array,
    truths: Array,
    truths_mask: Array,
    *,
    cutoff: Any,
    order: Any,
) -> CutoffCosts:
    """Compute min(c, ‖x − y‖) / c for every pair, not raised to the power; else `cutoff_costs`.

    Example:
        >>> point, there = jnp.zeros((1, 1)), jnp.ones(1, bool)
        >>> cutoff_distances(point, there, point + 3.0, there, cutoff=4.0, order=2.0).cost.tolist()
        [[0.75]]
    """
    check_array("estimates", estimates, shape=("M", "D"))
    rows, dimension = jnp.shape(estimates)
    check_array("estimates_mask", estimates_mask, shape=(rows,))
    check_array("truths", truths, shape=("N", dimension))
    check_array("truths_mask", truths_mask, shape=(jnp.shape(truths)[0],))
    check_array("cutoff", cutoff, shape=())
    check_array("order", order, shape=())
    check_known("cutoff", cutoff, lambda c: (c > 0) & np.isfinite(c), "a positive number")
    check_known("order", order, lambda p: (p >= 1) & np.isfinite(p), "a number of at least 1")

    dtype = jnp.result_type(estimates, truths, float)
    cutoff, order = jnp.asarray(cutoff, dtype), jnp.asarray(order, dtype)
    estimates, estimates_mask = _fill(jnp.asarray(estimates, dtype), estimates_mask)
    truths, truths_mask = _fill(jnp.asarray(truths, dtype), truths_mask)

    distance = safe_norm(estimates[:, None, :] - truths[None, :, :], axis=-1)
    share = jnp.where(distance < cutoff, distance / cutoff, 1.0)
    return CutoffCosts(share, estimates_mask, truths_mask, cutoff, order)


def check_tracks(
    estimates: Array, estimates_mask: Array, truths: Array, truths_mask: Array
) -> tuple[int, int, int]:
    """Check two sets of tracks over the same looks; return how many looks, estimates and truths.

    Args:
        estimates: [T, I, D], T ≥ 1.
        estimates_mask: [T, I].
        truths: [T, K, D].
        truths_mask: [T, K].

    Raises:
        ValueError: shapes do not fit, or there is no look.
        TypeError: not real numbers.

    Example:
        >>> there = jnp.ones((5, 2), bool)
        >>> check_tracks(jnp.zeros((5, 2, 3)), there, jnp.zeros((5, 1, 3)), there[:, :1])
        (5, 2, 1)
    """
    check_array("estimates", estimates, shape=("T", "I", "D"))
    looks, left, dimension = jnp.shape(estimates)
    check_array("estimates_mask", estimates_mask, shape=(looks, left))
    check_array("truths", truths, shape=(looks, "K", dimension))
    right = jnp.shape(truths)[1]
    check_array("truths_mask", truths_mask, shape=(looks, right))
    if looks == 0:
        raise ValueError("estimates: got no looks, want at least one")
    return looks, left, right


def distances_over_time(
    estimates: Array,
    estimates_mask: Array,
    truths: Array,
    truths_mask: Array,
    *,
    cutoff: Any,
    order: Any,
) -> CutoffCosts:
    """Return `cutoff_distances` of every look of two sets of tracks, shaped as for `check_tracks`.

    Returns:
        Distances [T, I, K] and masks [T, I] and [T, K], with at least one column on either side.

    Example:
        >>> point, there = jnp.zeros((5, 1, 2)), jnp.ones((5, 1), bool)
        >>> sets = point, there, point + 3.0, there
        >>> distances_over_time(*sets, cutoff=1.0, order=2.0).cost.shape
        (5, 1, 1)
    """
    check_tracks(estimates, estimates_mask, truths, truths_mask)
    one = lambda *sets: cutoff_distances(*sets, cutoff=cutoff, order=order)
    return jax.vmap(one, out_axes=CutoffCosts(0, 0, 0, None, None))(  # pyright: ignore
        estimates, estimates_mask, truths, truths_mask
    )


def _fill(points: Array, mask: Array) -> tuple[Array, Array]:
    """Zero what is masked, which would come back as NaN in the gradient; have at least one row."""
    mask = jnp.asarray(mask, bool)
    points = jnp.where(mask[:, None], points, 0.0)
    absent = max(0, 1 - mask.size)  # the assignment wants no empty matrix
    return jnp.pad(points, ((0, absent), (0, 0))), jnp.pad(mask, (0, absent))
