"""Association by clustering on cloud models, for several echoes of a target.

The detections in the gates are clustered, each track starting a class, and the centre of a class
is the track's measurement: `moments.update_centroid` with the noise of a single echo.

What the paper leaves open, and decides whether it works: a detection outside a track's gate has
no certainty in its class; a class without detections stays at the track's prediction, and the
track coasts; a class is never narrower than the noise.
"""

import jax
import jax.numpy as jnp

from jaxtrack.association.gating import Association, AssociationParams, Gated, Predicted, gate
from jaxtrack.association.nearest import greedy_pairs
from jaxtrack.clustering.cloud import CloudMeans, cloud_cmeans
from jaxtrack.numerics.checks import check_choice
from jaxtrack.numerics.masked import masked_mean
from jaxtrack.types import Array, Key, Scan

PAIRINGS = ("class", "nearest")


def sampled(
    predicted: Predicted,
    scan: Scan,
    params: AssociationParams,
    key: Key | None = None,
    *,
    pairing: str = "class",
    iterations: int = 12,
) -> Association:
    """Associate by clouds whose widths are drawn, once a look: the paper's algorithm.

    It starts from u_ij = exp(−d²_ij). The least of the certainties over the axes is not invariant
    to rotations of the coordinates.

    Args:
        predicted: T tracks.
        scan: one look of M detections; their weights count in the classes' means.
        params: its gate.
        key: what is drawn depends on it, slot by slot.
        pairing: "class": the class that started at a track is the track's. "nearest", the paper's:
            the closest centres and tracks belong together, one to one and inside the gate. Static.
        iterations: at most so many. Static.

    Returns:
        Weights of the echoes in their classes; the miss is 1 where a class is empty.

    Raises:
        ValueError: there is no key, shapes do not fit, or no such pairing.
        TypeError: not real numbers.

    Example:
        >>> predicted = Predicted(jnp.array([[0.0, 0.0], [4.0, 0.0]]), jnp.stack([jnp.eye(2)] * 2),
        ...                       jnp.eye(2), jnp.ones(2, bool))
        >>> places = jnp.array([[0.0, 0.0], [1.0, 0.0], [4.0, 1.0]])
        >>> scan = Scan(jnp.array(0.0), jnp.array(True), places, jnp.ones(3, bool))
        >>> print(sampled(predicted, scan, AssociationParams(0.9, 1e-3), jax.random.key(0)).weight)
        [[1. 1. 0.]
         [0. 0. 1.]]

    Source: clustering cloud-like model (2019), section 3.2, equations 10 to 12.
    """
    if key is None:
        raise ValueError("key: got None, want a random key; `averaged` needs none")
    slots = jnp.arange(predicted.mask.shape[0])
    dtype = predicted.position_m.dtype
    # A key a slot: empty slots behind the others change no draw.
    draw = lambda slot: jax.random.normal(jax.random.fold_in(key, slot), (2,), dtype)
    return _associate(predicted, scan, params, jax.vmap(draw)(slots), None, pairing, iterations)


def averaged(
    predicted: Predicted,
    scan: Scan,
    params: AssociationParams,
    key: Key | None = None,
    *,
    pairing: str = "class",
    iterations: int = 12,
) -> Association:
    """Associate by clouds whose certainties are means over the widths: nothing is drawn.

    Args:
        predicted: T tracks.
        scan: one look of M detections; their weights count in the classes' means.
        params: its gate.
        key: not used.
        pairing: as in `sampled`. Static.
        iterations: at most so many. Static.

    Returns:
        Weights of the echoes in their classes; the miss is 1 where a class is empty.

    Raises:
        ValueError: shapes do not fit, or no such pairing.
        TypeError: not real numbers.

    Example:
        >>> predicted = Predicted(jnp.array([[0.0, 0.0], [4.0, 0.0]]), jnp.stack([jnp.eye(2)] * 2),
        ...                       jnp.eye(2), jnp.ones(2, bool))
        >>> places = jnp.array([[0.0, 0.0], [1.0, 0.0], [4.0, 1.0]])
        >>> scan = Scan(jnp.array(0.0), jnp.array(True), places, jnp.ones(3, bool))
        >>> print(averaged(predicted, scan, AssociationParams(0.9, 1e-3)).weight)
        [[1. 1. 0.]
         [0. 0. 1.]]

    Source: clustering cloud-like model (2019), section 3.1, "the mean of the certainty degree".
    """
    return _associate(predicted, scan, params, None, None, pairing, iterations)


def soft(
    predicted: Predicted,
    scan: Scan,
    params: AssociationParams,
    key: Key | None = None,
    *,
    temperature: Array | float = 0.2,
    iterations: int = 12,
) -> Association:
    """Associate as `averaged` does, with echoes shared by the classes: differentiable.

    Args:
        predicted: T tracks.
        scan: one look of M detections; their weights count in the classes' means.
        params: its gate.
        key: not used.
        temperature: of the softmax over the logarithms of the certainties; towards 0 the classes
            become crisp.
        iterations: so many. Static.

    Raises:
        ValueError: shapes do not fit.
        TypeError: not real numbers.

    Example:
        >>> predicted = Predicted(jnp.array([[0.0, 0.0], [3.0, 0.0]]), jnp.stack([jnp.eye(2)] * 2),
        ...                       jnp.eye(2), jnp.ones(2, bool))
        >>> places = jnp.array([[0.0, 0.0], [1.5, 0.0], [3.0, 0.0]])
        >>> scan = Scan(jnp.array(0.0), jnp.array(True), places, jnp.ones(3, bool))
        >>> print(soft(predicted, scan, AssociationParams(0.9, 1e-3)).weight[:, 1])
        [0.5 0.5]
    """
    return _associate(predicted, scan, params, None, temperature, "class", iterations)


def _associate(
    predicted: Predicted,
    scan: Scan,
    params: AssociationParams,
    xi: Array | None,
    temperature: Array | float | None,
    pairing: str,
    iterations: int,
) -> Association:
    check_choice("pairing", pairing, PAIRINGS)
    gated = gate(predicted, scan, params.gate)
    dtype = gated.squared_distance.dtype
    counts = gated.inside.any(0)
    places = jnp.where(counts[:, None], scan.position_m, 0.0)
    weight = jnp.ones_like(places[:, 0]) if scan.weight is None else scan.weight
    weight = jnp.where(counts, weight, 0.0)
    if scan.covariance_m2 is None:
        each = jnp.diagonal(predicted.noise_m2, axis1=-2, axis2=-1)
        if each.ndim == 2:  # a class is no track's yet: what they have on the average
            each = masked_mean(each, predicted.mask[:, None], axis=0)
        noise = jnp.broadcast_to(each, places.shape)
    else:
        own = jnp.diagonal(scan.covariance_m2, axis1=1, axis2=2)
        noise = jnp.where(counts[:, None], own, 1.0)
    found = cloud_cmeans(
        places,
        weight,
        -gated.squared_distance,
        centres=jnp.where(predicted.mask[:, None], predicted.position_m, 0.0).astype(dtype),
        floor=jnp.sqrt(noise),
        allowed=gated.inside,
        xi=xi,
        temperature=temperature,
        iterations=iterations,
    )
    members = found.members
    if pairing == "nearest" and members.shape[0] > 0:
        members = _of_nearest_centres(predicted, params, found, gated)
    taken = members * weight[None, :]
    # In a crisp class the detection's weight says how much it counts, not whether it is there.
    miss = (1 - (members * (weight > 0).astype(dtype)[None, :])).prod(-1)
    return Association(taken, miss, found.done)


def _of_nearest_centres(
    predicted: Predicted, params: AssociationParams, found: CloudMeans, gated: Gated
) -> Array:
    """Return the members of the class whose centre is each track's, [T, N]; of none: zeros."""
    full = found.cloud.mass > 0
    centres = Scan(jnp.zeros(()), jnp.asarray(True), found.cloud.expectation, full)
    near = gate(predicted._replace(view=None, gated=None), centres, params.gate)
    columns = greedy_pairs(near.squared_distance, near.inside)
    members = found.members[jnp.where(columns >= 0, columns, 0)]
    return jnp.where((columns >= 0)[:, None], members, 0.0).astype(gated.density_per_m2.dtype)
