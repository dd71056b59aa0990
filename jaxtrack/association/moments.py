"""A Kalman state updated from an association: one detection at most, or the centroid of several.

The measurement is the first two entries of the state, H = [I 0]. Covariances are sums of positive
semidefinite terms (Joseph's form), so that they stay so in single precision. They are symmetric up
to rounding: the prediction makes them so again, where it costs the least.
"""

import functools

import jax.numpy as jnp

from jaxtrack.association.gating import Association, OwnView, Predicted, innovations
from jaxtrack.association.step import (
    LEAST,
    Step,
    if_any,
    move,
    quotient,
    sandwich,
    weighted_outer,
)
from jaxtrack.numerics.checks import check_array, check_choice
from jaxtrack.types import Array, Scan

NOISES = ("shared", "single")


def update_mixture(
    mean: Array, covariance: Array, predicted: Predicted, scan: Scan, association: Association
) -> tuple[Array, Array]:
    """Return mean and covariance of the mixture over what a track's one detection may be.

        x⁺ = Σ_i β_i x_i,    P⁺ = Σ_i β_i [P_i + (x_i − x⁺)(x_i − x⁺)ᵀ]

    over the Kalman updates x_i, P_i with each detection and, for the miss, without any. With the
    same S for all detections that is P⁺ = β₀P + (1 − β₀)(P − K S Kᵀ) + K(Σβ_i v_i v_iᵀ − v̄ v̄ᵀ)Kᵀ.
    With all weight on one detection it is the Kalman update.

    Args:
        mean: [T, S] predicted states, position first.
        covariance: [T, S, S].
        predicted: their predicted measurements, as `predict_measurement` gives them.
        scan: one look of M detections.
        association: of it, with at most one detection a track: weights and miss add up to one.

    Returns:
        Means [T, S] and covariances [T, S, S]; what stands in empty slots stays.

    Raises:
        ValueError: shapes do not fit.
        TypeError: not real numbers.

    Example:
        >>> mean, covariance = jnp.zeros((1, 2)), jnp.eye(2)[None]
        >>> predicted = Predicted(mean, covariance, jnp.eye(2), jnp.ones(1, bool))
        >>> scan = Scan(jnp.array(0.0), jnp.array(True), jnp.ones((1, 2)), jnp.ones(1, bool))
        >>> one = Association(jnp.ones((1, 1)), jnp.zeros(1), jnp.array(True))
        >>> print(*update_mixture(mean, covariance, predicted, scan, one))
        [[0.5 0.5]] [[[0.5 0. ]
          [0.  0.5]]]

    Source: Y. Bar-Shalom and E. Tse, 1975, for PDA; with one-hot weights equations 8, 14 and 15 of
        the clustering cloud-like model (2019).

    Note:
        Equation 15 prints a plus sign, with which the covariance diverges; it is a minus.
    """
    there = _check(mean, covariance, predicted, association)
    return if_any(_mixture, there, mean, covariance, predicted, scan, association)


def _mixture(
    there: Array,
    mean: Array,
    covariance: Array,
    predicted: Predicted,
    scan: Scan,
    association: Association,
) -> tuple[Array, Array]:
    found = innovations(predicted, scan)
    beta = jnp.where(found.present, association.weight, 0.0)
    ixx, ixy, iyy = found.inverse
    # y = S⁻¹ v: the state moves by P Hᵀ y.
    y = ixx * found.x_m + ixy * found.y_m, ixy * found.x_m + iyy * found.y_m
    ybar = tuple((beta * one).sum(-1) for one in y)
    total = beta.sum(-1)
    same = found.inverse[0].shape[1] == 1  # one S for all detections of a track
    if same:
        mean_inverse = tuple(one[:, 0] for one in found.inverse)
    else:
        mean_inverse = tuple(quotient((beta * one).sum(-1), total) for one in found.inverse)
    spread = weighted_outer(beta, y[0] - ybar[0][:, None], y[1] - ybar[1][:, None])
    missed = weighted_outer(association.miss[:, None], ybar[0][:, None], ybar[1][:, None])
    noise = tuple((beta * one).sum(-1) for one in sandwich(found.inverse, found.noise_m2))
    middle = [a + b + c for a, b, c in zip(spread, missed, noise, strict=True)]
    if not same:
        # Gains differ from detection to detection: their scatter about the mean gain.
        apart = tuple(
            one - bar[:, None] for one, bar in zip(found.inverse, mean_inverse, strict=True)
        )
        v = jnp.where(there[:, None, None], predicted.covariance_m2, 0.0)[:, None]
        scatter = sandwich(apart, (v[..., 0, 0], v[..., 0, 1], v[..., 1, 1]))
        middle = [one + (beta * more).sum(-1) for one, more in zip(middle, scatter, strict=True)]
    step = Step(ybar, mean_inverse, (middle[0], middle[1], middle[2]), total, association.miss)
    return move(mean, covariance, there, step)


def update_single(
    mean: Array, covariance: Array, predicted: Predicted, scan: Scan, association: Association
) -> tuple[Array, Array]:
    """Return `update_mixture` where a track has one detection or none: it looks at no other.

    Args:
        mean: [T, S] predicted states, position first.
        covariance: [T, S, S].
        predicted: their predicted measurements, as `predict_measurement` gives them.
        scan: one look of M detections.
        association: of it, a row's weights zero but for one at most.

    Returns:
        Means [T, S] and covariances [T, S, S]; what stands in empty slots stays.

    Raises:
        ValueError: shapes do not fit.
        TypeError: not real numbers.

    Example:
        >>> mean, covariance = jnp.zeros((1, 2)), jnp.eye(2)[None]
        >>> predicted = Predicted(mean, covariance, jnp.eye(2), jnp.ones(1, bool))
        >>> places = jnp.array([[9.0, 9.0], [1.0, 1.0]])
        >>> scan = Scan(jnp.array(0.0), jnp.array(True), places, jnp.ones(2, bool))
        >>> one = Association(jnp.array([[0.0, 1.0]]), jnp.zeros(1), jnp.array(True))
        >>> print(update_single(mean, covariance, predicted, scan, one)[0])
        [[0.5 0.5]]
    """
    there = _check(mean, covariance, predicted, association)
    tracks, detections = association.weight.shape
    if detections == 0:
        return update_mixture(mean, covariance, predicted, scan, association)
    some = association.weight > 0
    every = jnp.arange(detections, dtype=jnp.int32)
    taken = jnp.where(some, every[None, :], -1).max(1)
    seen, at = taken >= 0, jnp.maximum(taken, 0)
    slots = jnp.arange(tracks, dtype=jnp.int32)
    view = predicted.view
    place = scan.position_m[at] if view is None else view.position_m[slots, at]
    if view is not None:
        own = view.noise_m2[:, 0] if view.noise_m2.shape[1] == 1 else view.noise_m2[slots, at]
    elif scan.covariance_m2 is not None:
        own = scan.covariance_m2[at]
    else:
        own = jnp.broadcast_to(predicted.noise_m2, (tracks, 2, 2))
    unit = jnp.eye(2, dtype=mean.dtype)[None]
    mine = OwnView(
        jnp.where(seen[:, None], place, 0.0)[:, None],
        jnp.where(seen[:, None, None], own, unit)[:, None],
    )
    one = jnp.ones(1, bool)
    look = Scan(scan.time_s, scan.valid, jnp.zeros((1, 2), mean.dtype), one)
    weight = association._replace(weight=association.weight.sum(1, keepdims=True))
    return _mixture(there, mean, covariance, predicted._replace(view=mine), look, weight)


def update_centroid(
    mean: Array,
    covariance: Array,
    predicted: Predicted,
    scan: Scan,
    association: Association,
    *,
    noise: str = "shared",
) -> tuple[Array, Array]:
    """Return the Kalman update with the weighted centroid of a track's echoes.

        z̄ = Σ w_i z_i / n,    n = Σ w_i

    Its noise is, "shared", that of the mean of n echoes and of not knowing which they are,

        R/n + Σ w_i (1 − w_i) δ_i δ_iᵀ / n²,    δ_i = z_i − z̄,

    or, "single", R alone, as in the cloud-model paper. As n goes to zero the track coasts.

    Args:
        mean: [T, S] predicted states, position first.
        covariance: [T, S, S].
        predicted: their predicted measurements, as `predict_measurement` gives them.
        scan: one look of M detections.
        association: of it, with any number of detections a track.
        noise: "shared" or "single". Static.

    Returns:
        Means [T, S] and covariances [T, S, S]; what stands in empty slots stays.

    Raises:
        ValueError: shapes do not fit, or no such noise.
        TypeError: not real numbers.

    Example:
        >>> mean, covariance = jnp.zeros((1, 2)), jnp.eye(2)[None]
        >>> predicted = Predicted(mean, covariance, 2 * jnp.eye(2), jnp.ones(1, bool))
        >>> scan = Scan(jnp.array(0.0), jnp.array(True), jnp.ones((2, 2)), jnp.ones(2, bool))
        >>> both = Association(jnp.ones((1, 2)), jnp.zeros(1), jnp.array(True))
        >>> print(update_centroid(mean, covariance, predicted, scan, both)[0])
        [[0.5 0.5]]

    Source: clustering cloud-like model (2019), equations 8 and 13 to 15.

    Note:
        A scan's own covariances stand for R: Σ w_i R_i / n² when shared, Σ w_i R_i / n when single.
        "single" mixes the update with coasting by the association's miss.
    """
    check_choice("noise", noise, NOISES)
    there = _check(mean, covariance, predicted, association)
    update = functools.partial(_centroid, noise)
    return if_any(update, there, mean, covariance, predicted, scan, association)


def _centroid(
    noise: str,
    there: Array,
    mean: Array,
    covariance: Array,
    predicted: Predicted,
    scan: Scan,
    association: Association,
) -> tuple[Array, Array]:
    found = innovations(predicted, scan)
    weight = jnp.where(found.present, association.weight, 0.0)
    count = weight.sum(-1)
    some = count > LEAST
    x, y = (quotient((weight * one).sum(-1), count) for one in (found.x_m, found.y_m))
    unsure = weight * (1 - weight)
    spread = weighted_outer(unsure, found.x_m - x[:, None], found.y_m - y[:, None])
    r = tuple((weight * one).sum(-1) for one in found.noise_m2)
    if noise == "single":
        factor = some.astype(count.dtype)
        spread = tuple(jnp.zeros_like(one) for one in spread)
        total, miss = factor * (1 - association.miss), 1 - factor * (1 - association.miss)
    else:
        factor = jnp.where(some, count, 0.0)
        total, miss = jnp.ones_like(count), jnp.zeros_like(count)
    # With f the factor, S = V + N/f, so that S⁻¹ = f (f V + N)⁻¹ is smooth where f is zero.
    v = jnp.where(there[:, None, None], predicted.covariance_m2, 0.0)
    unit = (1.0, 0.0, 1.0)
    n = [
        jnp.where(some, quotient(a + b, count), e) for a, b, e in zip(r, spread, unit, strict=True)
    ]
    sxx, sxy, syy = (
        factor * one + more
        for one, more in zip((v[:, 0, 0], v[:, 0, 1], v[:, 1, 1]), n, strict=True)
    )
    determinant = sxx * syy - sxy * sxy
    definite = determinant > 0
    determinant = jnp.where(definite, determinant, 1.0)
    inverse = syy / determinant, -sxy / determinant, sxx / determinant
    inverse = tuple(jnp.where(definite, one, 0.0) for one in inverse)
    ixx, ixy, iyy = (factor * one for one in inverse)
    moved = ixx * x + ixy * y, ixy * x + iyy * y
    noises = tuple(factor * one for one in sandwich(inverse, n))  # S⁻¹ (N/f) S⁻¹
    # Between the update and none, where a miss is possible: the spread of the two means.
    between = weighted_outer((total * miss)[:, None], moved[0][:, None], moved[1][:, None])
    middle = tuple(total * one + more for one, more in zip(noises, between, strict=True))
    step = Step((total * moved[0], total * moved[1]), (ixx, ixy, iyy), middle, total, miss)
    return move(mean, covariance, there, step)


def _check(mean: Array, covariance: Array, predicted: Predicted, association: Association) -> Array:
    check_array("mean", mean, shape=("T", "S"))
    tracks, size = mean.shape
    check_array("covariance", covariance, shape=(tracks, size, size))
    check_array("predicted.mask", predicted.mask, shape=(tracks,))
    check_array("association.weight", association.weight, shape=(tracks, "M"))
    return predicted.mask.astype(bool)
