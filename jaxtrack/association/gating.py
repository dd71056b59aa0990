"""Which detections of a look a track may take, and how likely they are.

    d²_ij = v_ijᵀ S_ij⁻¹ v_ij < γ,    v_ij = z_i − ẑ_j,    S_ij = H P_j Hᵀ + R_i

All associators are functions of the predicted tracks and one look, with one signature
(`Associate`) and one kind of answer (`Association`). Tracks and detections stand in tables of
fixed size; what is masked, has weight 0 or belongs to an invalid look is outside every gate.
"""

from typing import NamedTuple, Protocol

import jax.numpy as jnp

from jaxtrack.numerics.checks import check_array
from jaxtrack.types import Array, Key, Scan


class AssociationParams(NamedTuple):
    """What associators know of a sensor. Traced; each reads what its equations need."""

    p_detect: Array | float  # [] or [T] probability that a target is detected in this look
    clutter_per_m2: Array | float  # [] β, expected false detections a square metre
    gate: Array | float = 9.21  # [] γ, squared Mahalanobis distance; 9.21 holds 99 % in 2-D
    echoes: Array | float = 1.0  # [] λ, mean number of echoes of a detected target


class OwnView(NamedTuple):
    """A look as each track sees it, where that differs from track to track. Finite throughout."""

    position_m: Array  # [T, M, 2] z
    noise_m2: Array  # [T, M, 2, 2] R, or [T, 1, 2, 2] of all detections


class Gated(NamedTuple):
    """What the gate leaves."""

    squared_distance: Array  # [T, M] d²; 0 where there is no pair
    inside: Array  # [T, M]
    density_per_m2: Array  # [T, M] detection's weight × N(z; ẑ, S); zero outside the gate


class Predicted(NamedTuple):
    """Where the tracks are expected in a look; T slots."""

    position_m: Array  # [T, 2] ẑ
    covariance_m2: Array  # [T, 2, 2] H P Hᵀ, without the measurement's noise
    noise_m2: Array  # [2, 2] or [T, 2, 2] R, where a scan has no covariances of its own
    mask: Array  # [T]
    view: OwnView | None = None  # stands for the scan's positions and covariances
    gated: Gated | None = None  # what the gate left of the look, where it has been asked before


class Association(NamedTuple):
    """How far each detection is each track's."""

    weight: Array  # [T, M] in [0, 1]; zero outside the gate and in empty slots
    miss: Array  # [T] probability that none is the track's; 1 in empty slots
    converged: Array  # [] False: an iteration ended before it settled


class Associate(Protocol):
    """An associator: a function of one look, without a memory."""

    def __call__(
        self, predicted: Predicted, scan: Scan, params: AssociationParams, key: Key | None = None
    ) -> Association:
        """Associate the tracks with the detections; only the sampled ones read the key."""
        ...


class Innovations(NamedTuple):
    """Differences z − ẑ, and what is known of them, entry by entry; finite behind every mask."""

    x_m: Array  # [T, M]
    y_m: Array  # [T, M]
    noise_m2: tuple[Array, Array, Array]  # R: xx, xy, yy, each [T or 1, M or 1]
    inverse: tuple[Array, Array, Array]  # S⁻¹: xx, xy, yy, each [T, M] or [T, 1]
    determinant: Array  # det S, [T, M] or [T, 1]
    present: Array  # [T, M] track and detection exist, S is positive definite
    weight: Array  # [1, M] of the detections


def predict_measurement(
    mean: Array, covariance: Array, noise_m2: Array, mask: Array | None = None
) -> Predicted:
    """Return where tracks are expected: ẑ = H x, H P Hᵀ, with H x the first two entries of x.

    Args:
        mean: [T, S] predicted states, position first, in m.
        covariance: [T, S, S].
        noise_m2: [2, 2], or [T, 2, 2] of each track, R, covariance of one detection.
        mask: [T] which slots hold a track; all by default.

    Raises:
        ValueError: shapes do not fit.
        TypeError: not real numbers.

    Example:
        >>> predicted = predict_measurement(jnp.ones((1, 4)), jnp.eye(4)[None], jnp.eye(2))
        >>> print(predicted.position_m)
        [[1. 1.]]

    Source: clustering cloud-like model (2019), equations 5 and 7.
    """
    check_array("mean", mean, shape=("T", "S"))
    tracks, size = mean.shape
    check_array("covariance", covariance, shape=(tracks, size, size))
    own = (tracks,) if jnp.ndim(noise_m2) == 3 else ()
    check_array("noise_m2", noise_m2, shape=(*own, 2, 2))
    mask = jnp.ones(tracks, bool) if mask is None else mask
    check_array("mask", mask, shape=(tracks,))
    return Predicted(mean[:, :2], covariance[:, :2, :2], jnp.asarray(noise_m2, mean.dtype), mask)


def innovations(predicted: Predicted, scan: Scan) -> Innovations:
    """Return z_i − ẑ_j and the inverse of S_ij for all pairs, 2 × 2 matrices written out.

    Args:
        predicted: T tracks.
        scan: one look of M detections; its own covariances count, where it has them.

    Raises:
        ValueError: shapes do not fit.
        TypeError: not real numbers.

    Example:
        >>> predicted = Predicted(jnp.zeros((1, 2)), jnp.eye(2)[None], jnp.eye(2), jnp.ones(1, bool))
        >>> scan = Scan(jnp.array(0.0), jnp.array(True), jnp.ones((1, 2)), jnp.ones(1, bool))
        >>> print(innovations(predicted, scan).x_m)
        [[1.]]

    Source: clustering cloud-like model (2019), equations 7 and 9.

    Note:
        A detection's delay is not looked at: tracks are predicted to the look's time.
    """  # noqa: E501
    check_array("predicted.position_m", predicted.position_m, shape=("T", 2))
    tracks = predicted.position_m.shape[0]
    check_array("predicted.covariance_m2", predicted.covariance_m2, shape=(tracks, 2, 2))
    check_array("predicted.mask", predicted.mask, shape=(tracks,))
    check_array("scan.position_m", scan.position_m, shape=("M", 2))
    detections = scan.position_m.shape[0]
    check_array("scan.mask", scan.mask, shape=(detections,))
    dtype = predicted.position_m.dtype
    there = predicted.mask.astype(bool)
    counts, weight = _counted(scan, dtype)
    z = jnp.where(counts[:, None], scan.position_m, 0.0)
    expected = jnp.where(there[:, None], predicted.position_m, 0.0)
    pair = there[:, None] & counts[None, :]
    z = z[None] if predicted.view is None else predicted.view.position_m
    x, y = (jnp.where(pair, z[:, :, k] - expected[:, None, k], 0.0) for k in (0, 1))

    unit = jnp.eye(2, dtype=dtype)[None]
    if predicted.view is not None:
        r = jnp.where(there[:, None, None, None], predicted.view.noise_m2, unit[None])
    elif scan.covariance_m2 is not None:
        check_array("scan.covariance_m2", scan.covariance_m2, shape=(detections, 2, 2))
        r = jnp.where(counts[:, None, None], scan.covariance_m2, unit)[None]
    else:
        r = predicted.noise_m2.reshape(-1, 1, 2, 2)
    v = jnp.where(there[:, None, None], predicted.covariance_m2, unit)
    noise = r[..., 0, 0], r[..., 0, 1], r[..., 1, 1]
    xx = v[:, 0, 0][:, None] + noise[0]
    xy = v[:, 0, 1][:, None] + noise[1]
    yy = v[:, 1, 1][:, None] + noise[2]
    determinant = xx * yy - xy * xy
    # What is less is rounding, of which the compiler makes another each time it makes this anew.
    definite = (determinant > 4 * jnp.finfo(dtype).eps * xx * yy) & (xx > 0)
    determinant = jnp.where(definite, determinant, 1.0)
    # Without an inverse there is none: entries themselves may be too large to be squared.
    over = jnp.where(definite, 1 / determinant, 0.0)
    inverse = yy * over, -xy * over, xx * over
    return Innovations(x, y, noise, inverse, determinant, pair & definite, weight[None])


def gate(predicted: Predicted, scan: Scan, gate: Array | float = 9.21) -> Gated:
    """Return squared Mahalanobis distances, which of them are inside the gate, and densities.

        d² = vᵀ S⁻¹ v < γ,    w N(v; 0, S) = w exp(−d²/2) / (2π √det S)

    Args:
        predicted: T tracks; of those that were `gated_once` only masks and weights are looked at.
        scan: one look of M detections.
        gate: γ.

    Raises:
        ValueError: shapes do not fit.

    Example:
        >>> predicted = Predicted(jnp.zeros((1, 2)), jnp.eye(2)[None], jnp.eye(2), jnp.ones(1, bool))
        >>> places = jnp.array([[2.0, 0.0], [9.0, 0.0]])
        >>> scan = Scan(jnp.array(0.0), jnp.array(True), places, jnp.ones(2, bool))
        >>> gated = gate(predicted, scan)
        >>> print(gated.squared_distance, gated.inside)
        [[ 2.  40.5]] [[ True False]]

    Source: clustering cloud-like model (2019), equation 9 and the sentence before it.
    """  # noqa: E501
    if predicted.gated is not None:
        counts, weight = _counted(scan, predicted.position_m.dtype)
        known = predicted.gated
        inside = known.inside & (predicted.mask.astype(bool)[:, None] & counts[None, :])
        density = jnp.where(inside, weight[None] * known.density_per_m2, 0.0)
        return known._replace(inside=inside, density_per_m2=density)
    found = innovations(predicted, scan)
    square = _square(found)
    inside = found.present & (square < jnp.asarray(gate, square.dtype))
    # Far pairs would underflow: their density is not asked for.
    near = jnp.where(inside, square, 0.0)
    peak = 1 / (2 * jnp.pi * jnp.sqrt(found.determinant))
    density = found.weight * (peak * jnp.exp(-near / 2))
    return Gated(square, inside, jnp.where(inside, density, 0.0))


def gated_once(predicted: Predicted, scan: Scan, limit: Array | float = 9.21) -> Predicted:
    """Return tracks that know their gates in a look, γ the limit, for all who ask again.

    Masks and the detections' weights may change afterwards, the look and γ may not.

    Example:
        >>> one = Predicted(jnp.zeros((1, 2)), jnp.eye(2)[None], jnp.eye(2), jnp.ones(1, bool))
        >>> scan = Scan(jnp.array(0.0), jnp.array(True), jnp.ones((1, 2)), jnp.ones(1, bool))
        >>> print(gate(gated_once(one, scan)._replace(mask=jnp.zeros(1, bool)), scan).inside)
        [[False]]
    """
    return predicted._replace(gated=gate(predicted, scan._replace(weight=None), limit))


def log_densities(predicted: Predicted, scan: Scan) -> Array:
    """Return log N(z; ẑ, S) of all pairs, whether in a gate or not, [T, M]; without weights.

    Example:
        >>> one = Predicted(jnp.zeros((1, 2)), jnp.eye(2)[None], jnp.eye(2), jnp.ones(1, bool))
        >>> scan = Scan(jnp.array(0.0), jnp.array(True), jnp.ones((1, 2)), jnp.ones(1, bool))
        >>> print(log_densities(one, scan).round(2))
        [[-3.03]]
    """
    found = innovations(predicted, scan)
    return -(_square(found) + jnp.log(4 * jnp.pi**2 * found.determinant)) / 2


def _square(found: Innovations) -> Array:
    """Return d²."""
    ixx, ixy, iyy = found.inverse
    return ixx * found.x_m**2 + 2 * ixy * found.x_m * found.y_m + iyy * found.y_m**2


def _counted(scan: Scan, dtype: jnp.dtype) -> tuple[Array, Array]:
    """Return which detections count, and their weights, [M]."""
    counts = scan.mask.astype(bool) & scan.valid
    if scan.weight is None:
        return counts, jnp.where(counts, jnp.ones(counts.shape, dtype), 0.0)
    check_array("scan.weight", scan.weight, shape=counts.shape)
    weight = jnp.where(counts, scan.weight, 0.0)
    return counts & (weight > 0), weight
