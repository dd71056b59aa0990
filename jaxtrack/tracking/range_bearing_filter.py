"""Tracks seen in range and bearing: the extended and the unscented Kalman filter in a tracker."""

from collections.abc import Sequence

import jax
import jax.numpy as jnp

from jaxtrack.association import OwnView, Predicted, predict_measurement
from jaxtrack.filtering import extended
from jaxtrack.filtering.gaussian import Moments
from jaxtrack.filtering.polar import Linearize
from jaxtrack.models import (
    Motion,
    PolarScan,
    polar_to_earth,
    range_bearing,
    range_bearing_residual,
)
from jaxtrack.numerics.checks import check_array, check_mask
from jaxtrack.tracking.filters import Filter, as_it_is, at_rest, check_sigmas, learn, moving
from jaxtrack.types import Array, Scan


def range_bearing_filter(
    motion: Motion,
    sigma_range_m: Array | float,
    sigma_bearing_rad: Array | float,
    birth_sigma: Array | Sequence[Array | float],
    *,
    mount_m: Array | tuple[float, float] = (0.0, 0.0),
    linearize: Linearize = extended.linearize,
) -> Filter[Moments]:
    """Return the extended, or unscented, Kalman filter of targets seen in range and bearing.

    The innovation is the native one, its bearing wrapped. Gates, densities and updates have it in
    metres, pulled back through the measurement's own tangent at each track,

        h(x) ≈ h₀ + G (p − p̂):   z ↦ p̂ + G⁻¹ (z − h₀),   R ↦ G⁻¹ R G⁻ᵀ,

    which changes none of them but for the unit: K, P and d² are those of z itself, and densities
    are a square metre, as clutter is. Tracks start where a detection lies.

    Args:
        motion: of the targets, with states of S entries.
        sigma_range_m: [] where a `PolarScan` has no covariances.
        sigma_bearing_rad: [].
        birth_sigma: [S − 2] deviations of what a new track's detection does not tell.
        mount_m: [2] of the sensor in the body frame.
        linearize: `extended.linearize`, or `unscented.linearize` with or without a spread.

    Raises:
        ValueError: a known number that cannot be.

    Example:
        >>> from jaxtrack.models import constant_velocity
        >>> from jaxtrack.types import Pose
        >>> filter = range_bearing_filter(constant_velocity(0.1), 1.0, 0.01, (3.0, 3.0))
        >>> scan = PolarScan(jnp.array(0.0), jnp.array(True), jnp.array([100.0]), jnp.array([0.1]),
        ...                  jnp.array([True]), Pose(jnp.zeros(2), jnp.array(0.0)))
        >>> look = filter.look(scan)
        >>> print(look.position_m.round(1), filter.start(look).covariance[0, :2, :2].round(2))
        [[99.5 10. ]] [[1. 0.]
         [0. 1.]]
    """
    check_sigmas(sigma_range_m=sigma_range_m, sigma_bearing_rad=sigma_bearing_rad)

    def noise_of(scan: PolarScan, seen: Array) -> Array:
        """Return R, [1, 2, 2] or [N, 2, 2], in m² and rad²."""
        dtype = scan.range_m.dtype
        own = [jnp.asarray(x, dtype) ** 2 for x in (sigma_range_m, sigma_bearing_rad)]
        shared = jnp.diag(jnp.stack(own))[None]
        if scan.covariance is None:
            return shared
        return jnp.where(seen[:, None, None], scan.covariance, shared)

    def look(scan: PolarScan) -> Scan:
        check_array("scan.range_m", scan.range_m, shape=("N",))
        check_array("scan.bearing_rad", scan.bearing_rad, shape=scan.range_m.shape)
        check_mask("scan.mask", scan.mask, shape=scan.range_m.shape)
        scan, seen = _sound(scan)
        place = lambda at: polar_to_earth(at[0], at[1], scan.pose, mount_m)
        native = jnp.stack([scan.range_m, scan.bearing_rad], axis=1)
        tangent = jax.vmap(jax.jacfwd(place))(native)
        spread = tangent @ noise_of(scan, seen) @ jnp.swapaxes(tangent, 1, 2)
        return Scan(scan.time_s, scan.valid, jax.vmap(place)(native), seen, spread)

    def start(look: Scan) -> Moments:
        return at_rest(look, 1.0, birth_sigma, None)

    def measure(beliefs: Moments, scan: PolarScan, mask: Array) -> Predicted:
        scan, seen = _sound(scan)
        expected = lambda state: range_bearing(state, scan.pose, mount_m)
        near = lambda mean, p: linearize(expected, mean, p, range_bearing_residual)
        linear = jax.vmap(near)(*beliefs)
        # A measurement of the place alone: the tangent is nothing but G, the unscented one too.
        back, regular = _inverse(linear.matrix[:, :, :2])
        native = jnp.stack([scan.range_m, scan.bearing_rad], axis=1)
        apart = range_bearing_residual(native[None], linear.value[:, None])
        noise = noise_of(scan, seen)[None] + linear.excess[:, None]
        place = beliefs.mean[:, None, :2] + jnp.einsum("tij,tnj->tni", back, apart)
        spread = jnp.einsum("tij,tnjk,tlk->tnil", back, noise, back)
        predicted = predict_measurement(*beliefs, spread[:, 0], mask & regular)
        return predicted._replace(view=OwnView(place, spread))

    return Filter(look, start, moving(motion, linearize), measure, learn, as_it_is)


def _sound(scan: PolarScan) -> tuple[PolarScan, Array]:
    """Return a look that is finite behind its mask, and which detections count, [N]."""
    pose = scan.pose
    whole = jnp.isfinite(pose.position_m).all() & jnp.isfinite(pose.heading_rad)
    valid = scan.valid & whole & jnp.isfinite(scan.time_s)
    seen = scan.mask & valid & jnp.isfinite(scan.range_m) & jnp.isfinite(scan.bearing_rad)
    if scan.covariance is not None:
        seen = seen & jnp.isfinite(scan.covariance).all((1, 2))
    clean = lambda x: jnp.where(seen, x, 0.0)
    scan = scan._replace(
        valid=valid,
        range_m=clean(scan.range_m),
        bearing_rad=clean(scan.bearing_rad),
        pose=jax.tree.map(lambda x: jnp.where(valid, x, 0.0), pose),
    )
    return scan, seen


def _inverse(matrix: Array) -> tuple[Array, Array]:
    """Return inverses of matrices [T, 2, 2], and which have one."""
    a, b, c, d = (matrix[:, i, j] for i in (0, 1) for j in (0, 1))
    determinant = a * d - b * c
    rounding = 4 * jnp.finfo(matrix.dtype).eps * (jnp.abs(a * d) + jnp.abs(b * c))
    regular = jnp.abs(determinant) > rounding
    over = 1 / jnp.where(regular, determinant, 1.0)
    rows = jnp.stack([d, -b], axis=1), jnp.stack([-c, a], axis=1)
    return over[:, None, None] * jnp.stack(rows, axis=1), regular
