"""The Zernike paper's tracker: particles weigh what the points around them are like a template.

Each particle looks at the points in a disc about it. Seven moments of them, on a logarithmic scale,
make an angle with those of the template, which the target's first frames gave; the smaller it is,
the more the particle weighs. `particle_filter` does the rest.
"""

import math
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from jaxtrack.filtering.particle import ParticleState, particle_filter
from jaxtrack.filtering.resampling import Resampled, systematic
from jaxtrack.moments import (
    LOW_ORDERS,
    PAPER_ORDERS,
    Windows,
    cloud_windows,
    hu,
    log_features,
    zernike,
)
from jaxtrack.numerics.checks import check_array, check_choice, check_known, check_size
from jaxtrack.numerics.safe import safe_norm
from jaxtrack.tracking.moment_match import (
    aligned,
    angle_log_likelihood,
    first_threshold,
    similarity_angle,
)
from jaxtrack.types import Array, Estimator, Key, Scan

FEATURES = ("zernike", "low_zernike", "hu")
ORIGINS = ("particle", "centroid")

_FEWEST = 3  # points in a window that has features; of one that has fewer the angle is π
_ORDERS = {"zernike": PAPER_ORDERS, "low_zernike": LOW_ORDERS}


class MomentParams(NamedTuple):
    """Settings of the paper; what it does not give is marked. Traced."""

    radius_m: Array | float = 1.0  # [] r, of template and windows
    spread_m: Array | float = 1.0  # [] of the first particles about the target, each coordinate
    step_m: Array | float = 1.0  # [] of a particle's step, each coordinate; the paper: r
    fast_m: Array | float = 0.3  # [] L between two estimates from which the target is fast
    sigma: Array | float = 0.3  # [] σ of the weights; ours
    jitter_m: Array | float = 0.1  # [] added after resampling, each coordinate; ours


class MomentTrackerState(NamedTuple):
    """What the next cloud needs."""

    filter: ParticleState
    places_m: Array  # [2, 2] the last two estimates, the older first
    threshold_rad: Array  # [] α_threshold
    weighed: Array  # [] there has been a first weighting, which sets it


class MomentTrackerInfo(NamedTuple):
    """What people look at. Particles and weights are those before resampling."""

    position_m: Array  # [2] the estimate
    particles: Array  # [N, 2]
    weight: Array  # [N]
    angle_rad: Array  # [N] to the template; π where a window holds fewer than three points
    lost: Array  # [] no particle's window was like the template: weights stayed as they were
    overflow: Array  # [] more points lay around the particles than there are places


def moment_template(
    clouds: Scan,
    places_m: Array,
    params: MomentParams = MomentParams(),  # noqa: B008 - an immutable tuple
    *,
    features: str = "zernike",
    origin: str = "particle",
) -> Array:
    """Return the template, [7]: the mean of a target's features in some frames.

    Frames that are not valid, or show fewer than three points about the target, do not count. Where
    none is left the template is zero, and what is tracked by it is lost from the first look on.

    Args:
        clouds: the first frames, stacked; the paper takes three.
        places_m: [T, 2] of the target in each, say the centroid of its points.
        params: the radius counts.
        features: one of `FEATURES`. Static.
        origin: one of `ORIGINS`. Static.

    Raises:
        ValueError: an unknown word, or a shape that does not fit.

    Example:
        >>> at = jnp.array([[[0.3, 0.0], [0.0, 0.4], [-0.5, 0.1]]] * 3)
        >>> clouds = Scan(jnp.zeros(3), jnp.ones(3, bool), at, jnp.ones((3, 3), bool))
        >>> print(moment_template(clouds, jnp.zeros((3, 2)), features="low_zernike").shape)
        (7,)

    Source: Zernike moment paper (2023), section 2.3.2.
    """
    check_array("places_m", places_m, shape=(clouds.mask.shape[0], 2))
    places = clouds.mask.shape[1]

    def one(cloud: Scan, place_m: Array) -> tuple[Array, Array]:
        windows = cloud_windows(cloud, place_m[None], radius_m=params.radius_m, most=places)
        found, enough = _features(windows, params, features, origin)
        return found[0], enough[0] & cloud.valid

    found, counts = jax.vmap(one)(clouds, places_m)
    number = counts.sum(dtype=found.dtype)
    return jnp.where(counts[:, None], found, 0.0).sum(0) / jnp.where(number > 0, number, 1.0)


def moment_tracker(
    template: Array,
    places_m: Array,
    params: MomentParams = MomentParams(),  # noqa: B008 - an immutable tuple
    *,
    features: str = "zernike",
    origin: str = "particle",
    optimised: Array | bool = True,
    particles: int = 120,
    most: int = 256,
) -> Estimator[Scan, MomentTrackerState, MomentTrackerInfo]:
    """Return the paper's tracker of one target, as an estimator over point clouds.

        x_k = x_{k−1} + w,   w ~ N(0, step² I₂),   half of w turned by `aligned` if L > 0.3 m

    Args:
        template: [7] of `moment_template`, with the same `features` and `origin`.
        places_m: [2, 2] of the target in the last two frames, the older first.
        params: radius, steps and weights.
        features: one of `FEATURES`: the paper's Zernike moments, a set of low orders, or Hu's.
        origin: of the moments, `"particle"` or the `"centroid"` of its points; Hu's are about the
            centroid either way. Static.
        optimised: [] the paper's optimised transition; False: steps have no direction.
        particles: N. Static.
        most: places for points around the particles, which `overflow` says are too few. Static.

    Returns:
        An estimator. A cloud that is not valid changes nothing. Without a window like the template
        particles go on drifting apart, weights stay, and `lost` is set.

    Raises:
        TypeError: a size is not an int.
        ValueError: an unknown word, a size below 1, or a shape that does not fit.

    Example:
        >>> disc = jax.random.uniform(jax.random.key(0), (40, 2), minval=-0.4, maxval=0.4)
        >>> t = jnp.arange(8.0)
        >>> at = disc[None] + jnp.stack([0.2 * t, 0 * t], -1)[:, None]
        >>> clouds = Scan(t, jnp.ones(8, bool), at, jnp.ones((8, 40), bool))
        >>> places = at.mean(1)
        >>> first = jax.tree.map(lambda x: x[:3], clouds)
        >>> low = {"features": "low_zernike"}
        >>> template = moment_template(first, places[:3], **low)
        >>> tracker = moment_tracker(template, places[1:3], **low)
        >>> later = jax.tree.map(lambda x: x[3:], clouds)
        >>> _, info = jax.lax.scan(tracker.step, tracker.init(jax.random.key(1)), later)
        >>> print((jnp.linalg.norm(info.position_m - places[3:], axis=1) < 0.5).all())
        True

    Source: Zernike moment paper (2023), section 2.3 and Algorithm 1.

    Note:
        It says that moments are taken about the region's centre, and that windows are about the
        particles: `origin` has both. The weighted mean is not divided by N (equation 31).
    """
    check_array("template", template, shape=(7,))
    check_array("places_m", places_m, shape=(2, 2))
    check_choice("features", features, FEATURES)
    check_choice("origin", origin, ORIGINS)
    check_size("particles", particles)
    check_size("most", most)
    for name, value in params._asdict().items():
        check_array(f"params.{name}", value, shape=())
        check_known(f"params.{name}", value, lambda x: (x >= 0) & np.isfinite(x), "0 or more")
    for name in ("radius_m", "sigma"):
        value = getattr(params, name)
        check_known(f"params.{name}", value, lambda x: x > 0, "a positive number")
    check_known("places_m", places_m, np.isfinite, "finite places")
    dtype = jnp.result_type(template, float)
    template, places_m = jnp.asarray(template, dtype), jnp.asarray(places_m, dtype)
    params = MomentParams(*(jnp.asarray(x, dtype) for x in params))

    # A particle carries what its window showed: [x, y, angle, overflow].
    def initial(key: Key, size: int) -> Array:
        at = places_m[1:] + params.spread_m * jax.random.normal(key, (size, 2), dtype)
        unseen = jnp.broadcast_to(jnp.asarray([math.pi, 0.0], dtype), (size, 2))
        return jnp.concatenate([at, unseen], axis=1)

    def jittered(key: Key, particles: Array, log_weight: Array) -> Resampled:
        copy, shake = jax.random.split(key)
        copies = systematic(copy, particles, log_weight)
        noise = params.jitter_m * jax.random.normal(shake, (len(particles), 2), dtype)
        return copies._replace(particles=copies.particles.at[:, :2].add(noise))

    def build(state: MomentTrackerState) -> Estimator:
        apart = state.places_m[1] - state.places_m[0]
        fast = optimised & (safe_norm(apart) > params.fast_m)

        def transition(key: Key, particles: Array, observation: Scan) -> Array:
            draw, coin = jax.random.split(key)
            places = particles[:, :2]
            step = params.step_m * jax.random.normal(draw, places.shape, dtype)
            turned = jax.vmap(aligned, (0, None))(step, apart)
            turn = fast & jax.random.bernoulli(coin, 0.5, (len(places), 1))
            places = places + jnp.where(turn, turned, step)
            windows = cloud_windows(observation, places, radius_m=params.radius_m, most=most)
            found, enough = _features(windows, params, features, origin)
            enough = enough & (template != 0).any()
            angle = jax.vmap(similarity_angle, (0, None))(found, template)
            angle = jnp.where(enough, angle, math.pi)
            crowded = jnp.broadcast_to(windows.overflow, angle.shape).astype(dtype)
            return jnp.concatenate([places, angle[:, None], crowded[:, None]], axis=1)

        def log_likelihood(particles: Array, observation: Scan) -> Array:
            angle = particles[:, 2]
            first = first_threshold(angle, angle < math.pi)
            limit = jnp.where(state.weighed, state.threshold_rad, first)
            return angle_log_likelihood(angle, limit, params.sigma)

        return particle_filter(
            transition, log_likelihood, jittered, particles=particles, initial=initial
        )

    def init(key: Key) -> MomentTrackerState:
        empty: Any = None  # the filter's own state does not depend on ours
        none = MomentTrackerState(
            empty, places_m, jnp.full((), math.pi, dtype), jnp.zeros((), bool)
        )
        return none._replace(filter=build(none).init(key))

    def step(
        state: MomentTrackerState, cloud: Scan
    ) -> tuple[MomentTrackerState, MomentTrackerInfo]:
        after, info = build(state).step(state.filter, cloud)
        place_m, angle = info.mean[:2], info.particles[:, 2]
        first = cloud.valid & ~state.weighed & (angle < math.pi).any()
        threshold = jnp.where(first, first_threshold(angle, angle < math.pi), state.threshold_rad)
        moved = jnp.stack([state.places_m[1], place_m])
        places = jnp.where(cloud.valid, moved, state.places_m)
        shown = MomentTrackerInfo(
            places[1],
            info.particles[:, :2],
            jnp.exp(info.log_weight),
            angle,
            info.vanished,
            (info.particles[0, 3] > 0) & cloud.valid,
        )
        return MomentTrackerState(after, places, threshold, state.weighed | first), shown

    return Estimator(init, step)


def _features(
    windows: Windows, params: MomentParams, features: str, origin: str
) -> tuple[Array, Array]:
    """Return the features of N windows, [N, 7], and which have points enough, [N]."""
    check_choice("features", features, FEATURES)
    check_choice("origin", origin, ORIGINS)
    xy, weight = windows.xy, windows.weight
    if features == "hu":
        moments = jax.vmap(hu)(xy, weight)
    else:
        if origin == "centroid":
            mass = weight.sum(1)
            centre = (weight[..., None] * xy).sum(1) / jnp.where(mass > 0, mass, 1.0)[:, None]
            xy = xy - centre[:, None]
        moments = jax.vmap(
            lambda xy, w: zernike(xy, w, orders=_ORDERS[features], radius=params.radius_m)
        )(xy, weight)
    return log_features(moments), (weight > 0).sum(1) >= _FEWEST
