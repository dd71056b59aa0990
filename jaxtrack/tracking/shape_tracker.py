"""A tracker of our own for one target in point clouds: where it moves, and what stands there.

Particles have a velocity. Each compares what is in a soft window about it with a template, the
moments with their phases, so that which way an echo lies off the centre counts, and the mass; a
floor stands for looks in which clutter or nothing is seen. `particle_filter` does the rest.
"""

from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from jaxtrack.filtering.particle import ParticleState, particle_filter
from jaxtrack.filtering.resampling import systematic
from jaxtrack.moments import LOW_ORDERS, cloud_windows, soft_inside, zernike
from jaxtrack.numerics.checks import check_array, check_known, check_size
from jaxtrack.types import Array, Estimator, Key, Scan


class ShapeParams(NamedTuple):
    """Settings, traced; the defaults were found as `shape_tracker` says."""

    radius_m: Array | float = 1.0  # [] of template and windows
    taper: Array | float = 0.5  # [] share of the radius over which points fade
    spread_m: Array | float = 0.1  # [] of the first places, each coordinate
    speed_m_s: Array | float = 0.03  # [] of the first velocities, each coordinate
    shake_m: Array | float = 0.1  # [] of a place, a step, each coordinate
    change_m_s: Array | float = 0.015  # [] of a velocity, a step, each coordinate
    sigma: Array | float = 0.4  # [] of a moment about the template's
    mass_sigma: Array | float = 1.0  # [] of the log of the mass
    floor: Array | float = 1e-4  # [] likelihood of a window that shows something else


class ShapeTemplate(NamedTuple):
    """What the target looks like, and how it began."""

    moments: Array  # [7] complex
    mass: Array  # [] in the soft window
    place_m: Array  # [2] in the last frame
    velocity_m_s: Array  # [2]
    time_s: Array  # []


class ShapeTrackerState(NamedTuple):
    """What the next cloud needs."""

    filter: ParticleState
    time_s: Array  # [] of the last valid cloud


class ShapeTrackerInfo(NamedTuple):
    """What people look at. Particles and weights are those before resampling."""

    position_m: Array  # [2] the estimate
    velocity_m_s: Array  # [2]
    particles: Array  # [N, 4] x, y, vx, vy
    weight: Array  # [N]
    log_likelihood: Array  # [] of the cloud
    lost: Array  # [] no particle's window fits the template better than the floor does
    overflow: Array  # [] more points lay around the particles than there are places


def shape_template(
    clouds: Scan,
    places_m: Array,
    params: ShapeParams = ShapeParams(),  # noqa: B008 - an immutable tuple
) -> ShapeTemplate:
    """Return the template: means of moments and of log masses over some frames, and the motion.

    Where these hold nothing about the places, nothing is ever like it, and the target is lost.

    Args:
        clouds: the first frames, two or more, stacked; all valid.
        places_m: [T, 2] of the target in each: particles track what these mark.
        params: radius and taper count.

    Raises:
        ValueError: a shape that does not fit.

    Example:
        >>> at = jnp.array([[[0.3, 0.0], [0.0, 0.4], [-0.5, 0.1]]] * 3)
        >>> clouds = Scan(jnp.arange(3.0), jnp.ones(3, bool), at, jnp.ones((3, 3), bool))
        >>> template = shape_template(clouds, jnp.zeros((3, 2)))
        >>> print(template.moments.shape, template.mass.round(2), template.velocity_m_s)
        (7,) 3.0 [0. 0.]
    """
    check_array("places_m", places_m, shape=(clouds.mask.shape[0], 2))
    places = clouds.mask.shape[1]

    def one(cloud: Scan, place_m: Array) -> tuple[Array, Array]:
        moments, mass, _ = shape_features(cloud, place_m[None], params, most=places)
        return moments[0], mass[0]

    moments, mass = jax.vmap(one)(clouds, places_m)
    tiny = jnp.finfo(mass.dtype).tiny
    elapsed_s = clouds.time_s - clouds.time_s.mean()
    square = (elapsed_s**2).sum()
    slope = (elapsed_s[:, None] * places_m).sum(0) / jnp.where(square > 0, square, 1.0)
    return ShapeTemplate(
        moments.mean(0),
        jnp.exp(jnp.log(jnp.where(mass > tiny, mass, tiny)).mean()),
        places_m.mean(0) + slope * elapsed_s[-1],
        slope,
        clouds.time_s[-1],
    )


def shape_tracker(
    template: ShapeTemplate,
    params: ShapeParams = ShapeParams(),  # noqa: B008 - an immutable tuple
    *,
    particles: int = 120,
    most: int = 256,
) -> Estimator[Scan, ShapeTrackerState, ShapeTrackerInfo]:
    """Return the tracker of one target, as an estimator over point clouds.

        v' = v + n_v,   x' = x + Δt (v + v')/2 + n_x

        g = (1 − q) exp(−Σ_j |Z_j(x) − Z̄_j|²/2σ² − (ln m(x)/m̄)²/2σ_m²) + q

    Args:
        template: of `shape_template`, with the same radius and taper.
        params: motion, window and likelihood.
        particles: N. Static.
        most: places for points around the particles, which `overflow` says are too few. Static.

    Returns:
        An estimator. A cloud that is not valid changes nothing but the time that passes.

    Raises:
        TypeError: a size is not an int.
        ValueError: a size below 1, a known value that cannot be, or a shape that does not fit.

    Example:
        >>> disc = jax.random.uniform(jax.random.key(0), (40, 2), minval=-0.4, maxval=0.4)
        >>> t = 6 * jnp.arange(8.0)
        >>> at = disc[None] + jnp.stack([0.1 * t, 0 * t], -1)[:, None]
        >>> clouds = Scan(t, jnp.ones(8, bool), at, jnp.ones((8, 40), bool))
        >>> template = shape_template(jax.tree.map(lambda x: x[:3], clouds), at.mean(1)[:3])
        >>> tracker = shape_tracker(template)
        >>> later = jax.tree.map(lambda x: x[3:], clouds)
        >>> _, info = jax.lax.scan(tracker.step, tracker.init(jax.random.key(1)), later)
        >>> print((jnp.linalg.norm(info.position_m - at.mean(1)[3:], axis=1) < 0.3).all())
        True

    Note:
        Ours; no paper has it. Against the paper's tracker three things count: phases say which way
        the window is off, a velocity lets steps be small, and a floor keeps looks that show little
        from weighing much. The defaults were found on 32 runs of each scene of
        `sensors.dragged_bucket` at its own settings, trying σ from .15 (loses a tenth of the
        targets) to .6, floors from .01 to 1e-4, and changes of velocity from .01 to .02 m/s; the
        study `moment_tracking` reports on other runs, and on other speeds and distances.
    """
    check_array("template.moments", template.moments.real, shape=(len(LOW_ORDERS),))
    check_array("template.place_m", template.place_m, shape=(2,))
    check_array("template.velocity_m_s", template.velocity_m_s, shape=(2,))
    check_size("particles", particles)
    check_size("most", most)
    for name, value in params._asdict().items():
        check_array(f"params.{name}", value, shape=())
        check_known(f"params.{name}", value, lambda x: (x >= 0) & np.isfinite(x), "0 or more")
    for name in ("radius_m", "sigma", "mass_sigma", "floor"):
        value = getattr(params, name)
        check_known(f"params.{name}", value, lambda x: x > 0, "a positive number")
    check_known("params.floor", params.floor, lambda x: x < 1, "a likelihood below 1")
    dtype = template.place_m.dtype
    params = ShapeParams(*(jnp.asarray(x, dtype) for x in params))

    # A particle carries what its window showed: [x, y, vx, vy, log likelihood, overflow].
    def initial(key: Key, size: int) -> Array:
        draw = jax.random.normal(key, (size, 4), dtype)
        place = template.place_m[None] + params.spread_m * draw[:, :2]
        velocity = template.velocity_m_s[None] + params.speed_m_s * draw[:, 2:]
        return jnp.concatenate([place, velocity, jnp.zeros((size, 2), dtype)], axis=1)

    def build(state_s: Array) -> Estimator:
        def transition(key: Key, particles: Array, observation: Scan) -> Array:
            elapsed_s = (observation.time_s - state_s).astype(dtype)
            draw = jax.random.normal(key, (len(particles), 4), dtype)
            velocity = particles[:, 2:4] + params.change_m_s * draw[:, 2:]
            mean = (particles[:, 2:4] + velocity) / 2
            place = particles[:, :2] + elapsed_s * mean + params.shake_m * draw[:, :2]
            moments, mass, crowded = shape_features(observation, place, params, most=most)
            told = shape_log_likelihood(moments, mass, template, params)
            full = jnp.broadcast_to(crowded, told.shape).astype(dtype)
            return jnp.concatenate([place, velocity, told[:, None], full[:, None]], axis=1)

        return particle_filter(
            transition,
            lambda particles, observation: particles[:, 4],
            systematic,
            particles=particles,
            initial=initial,
        )

    def init(key: Key) -> ShapeTrackerState:
        return ShapeTrackerState(build(template.time_s).init(key), template.time_s)

    def step(state: ShapeTrackerState, cloud: Scan) -> tuple[ShapeTrackerState, ShapeTrackerInfo]:
        valid = cloud.valid & jnp.isfinite(cloud.time_s)
        cloud = cloud._replace(valid=valid)
        after, info = build(state.time_s).step(state.filter, cloud)
        shown = ShapeTrackerInfo(
            info.mean[:2],
            info.mean[2:4],
            info.particles[:, :4],
            jnp.exp(info.log_weight),
            info.log_likelihood,
            valid & (info.vanished | (info.particles[:, 4] < jnp.log(2 * params.floor)).all()),
            (info.particles[0, 5] > 0) & valid,
        )
        return ShapeTrackerState(after, jnp.where(valid, cloud.time_s, state.time_s)), shown

    return Estimator(init, step)


def shape_features(
    cloud: Scan, centres_m: Array, params: ShapeParams, *, most: int
) -> tuple[Array, Array, Array]:
    """Return moments [N, 7], complex, and masses [N] in soft windows about centres [N, 2].

    The last of the three says that there are more points around them than places, `most`.

    Example:
        >>> at = jnp.array([[0.3, 0.0], [0.0, 0.4], [-0.5, 0.1]])
        >>> cloud = Scan(jnp.array(0.0), jnp.array(True), at, jnp.ones(3, bool))
        >>> _, mass, _ = shape_features(cloud, jnp.array([[0.0, 0.0], [9.0, 0.0]]), ShapeParams(), most=3)
        >>> print(mass.round(2))
        [3. 0.]
    """  # noqa: E501
    near = cloud_windows(cloud, centres_m, radius_m=params.radius_m, most=most)

    def one(xy: Array, weight: Array) -> tuple[Array, Array]:
        faded = soft_inside(xy, weight, radius=params.radius_m, taper=params.taper)[1]
        return zernike(xy, faded, orders=LOW_ORDERS, radius=params.radius_m), faded.sum()

    return *jax.vmap(one)(near.xy, near.weight), near.overflow


def shape_log_likelihood(
    moments: Array, mass: Array, template: ShapeTemplate, params: ShapeParams
) -> Array:
    """Return log g of windows, [N], as `shape_tracker` has it.

    Args:
        moments: [N, 7] complex.
        mass: [N]; a window without any shows something else.
        template: what they are compared with.
        params: σ, σ_m and the floor q.

    Example:
        >>> z = jnp.zeros(7, complex)
        >>> template = ShapeTemplate(z, jnp.array(2.0), jnp.zeros(2), jnp.zeros(2), jnp.array(0.0))
        >>> seen = shape_log_likelihood(jnp.stack([z, z]), jnp.array([2.0, 0.0]), template, ShapeParams())
        >>> print(seen.round(3))
        [ 0.   -9.21]
    """  # noqa: E501
    off = moments - template.moments[None]
    apart = (off.real**2 + off.imag**2).sum(1)
    there = (mass > 0) & (template.mass > jnp.finfo(mass.dtype).tiny)
    light = jnp.log(jnp.where(there, mass, 1.0)) - jnp.log(jnp.where(there, template.mass, 1.0))
    fits = -apart / (2 * params.sigma**2) - light**2 / (2 * params.mass_sigma**2)
    fits = jnp.where(there, jnp.log1p(-params.floor) + fits, -jnp.inf)
    return jnp.logaddexp(fits, jnp.log(params.floor))
