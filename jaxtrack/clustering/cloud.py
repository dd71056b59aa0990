"""The cloud model: classes that are both fuzzy and random, and C-means on them.

A class is a cloud of drops about an expectation Ex. Its entropy En is how wide it is, its hyper
entropy He how uncertain that width is: a drop first draws its own width En' = En + He ξ, then its
place. How far a sample belongs to a cloud is its certainty degree,

    u = min_l exp( −(z_l − Ex_l)² / (2 En'_l²) ),

the least over the axes l. It is not normalized over the classes, and it is not invariant to
rotations: the axes of the coordinates matter.
"""

from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from jaxtrack.numerics.checks import check_array, check_size
from jaxtrack.numerics.safe import safe_divide, safe_max, safe_sqrt
from jaxtrack.types import Array, Key

_NODES, _NODE_WEIGHTS = np.polynomial.hermite_e.hermegauss(16)
_LOG_NODE_WEIGHTS = np.log(_NODE_WEIGHTS / _NODE_WEIGHTS.sum())


class Cloud(NamedTuple):
    """A class in D dimensions; K of them have [K] in front of every field."""

    expectation: Array  # [D] Ex
    entropy: Array  # [D] En ≥ 0, in the samples' unit
    hyper_entropy: Array  # [D] He ≥ 0, in the samples' unit
    mass: Array  # [] total weight of the samples it was made of


class CloudMeans(NamedTuple):
    """What C-means on clouds found."""

    cloud: Cloud  # [K] in front
    members: Array  # [K, N] share of each sample in each class: 0 or 1, or soft
    certainty: Array  # [K, N] u; zero where a sample may not belong to a class
    objective: Array  # [] J
    done: Array  # [] False: the last iteration still changed J by more than the tolerance


def backward(samples: Array, weights: Array) -> Cloud:
    """Return the cloud of some samples: the backward cloud generator without certainties.

        Ex = mean z,   En = √(π/2) mean |z − Ex|,   He = √|S² − En²|,   S² = Σ(z − Ex)² / (n − 1)

    with weighted means, n = Σw, and n − 1 at least 1. Without weight all of it is zero.

    Args:
        samples: [N, D].
        weights: [N] ≥ 0; a sample of weight w counts as w samples.

    Raises:
        ValueError: shapes do not fit.
        TypeError: not real numbers.

    Example:
        >>> cloud = backward(jnp.array([[0.0], [2.0]]), jnp.ones(2))
        >>> print(*(f"{float(x[0]):.3f}" for x in cloud[:3]))
        1.000 1.253 0.655

    Source: clustering cloud-like model (2019), section 3.1 and step 3.2 of section 3.2, where the
        generator is named; its equations are the usual ones.
    """
    check_array("samples", samples, shape=("N", "D"))
    check_array("weights", weights, shape=(samples.shape[0],))
    w = weights[:, None]
    mass = weights.sum()
    mass = jnp.where(mass > 1e-12, mass, 0.0)  # squares of less have no digits in single precision
    mean = safe_divide((w * samples).sum(0), mass)
    apart = samples - mean[None, :]
    # |x| has no gradient at 0, where the one sample of a class stands.
    distance = jnp.where(apart == 0, 0.0, jnp.abs(apart))
    entropy = jnp.sqrt(jnp.asarray(jnp.pi / 2, samples.dtype)) * safe_divide(
        (w * distance).sum(0), mass
    )
    others = jnp.where(mass > 2, mass - 1, 1.0)
    excess = (w * apart**2).sum(0) / others - entropy**2
    hyper = safe_sqrt(jnp.where(excess == 0, 0.0, jnp.abs(excess)))
    return Cloud(mean, entropy, hyper, mass)


def forward(key: Key, cloud: Cloud, *, drops: int) -> tuple[Array, Array]:
    """Return drops of one cloud [drops, D], and their certainty degrees [drops].

        En' = En + He ξ,   z ~ N(Ex, En'²),   u = min_l exp(−(z_l − Ex_l)² / (2 En'_l²))

    Args:
        key: what is drawn depends on it.
        cloud: in D dimensions.
        drops: how many. Static.

    Raises:
        TypeError: `drops` is not an int.

    Example:
        >>> cloud = Cloud(jnp.array([5.0]), jnp.array([2.0]), jnp.array([0.1]), jnp.array(1.0))
        >>> drops, certainty = forward(jax.random.key(0), cloud, drops=1000)
        >>> print(f"{drops.mean():.0f} {drops.std():.0f}")
        5 2

    Source: clustering cloud-like model (2019), section 3.1, where the generator is named.
    """
    check_size("drops", drops)
    shape, dtype = (2, drops, *cloud.entropy.shape), cloud.entropy.dtype
    xi, zeta = jax.random.normal(key, shape, dtype)
    spread = cloud.entropy[None, :] + cloud.hyper_entropy[None, :] * xi
    samples = cloud.expectation[None, :] + jnp.abs(spread) * zeta
    # A drop's distance in units of its own width is what was drawn; no division is needed.
    return samples, jnp.exp(-safe_max(zeta**2) / 2)


def log_certainty(samples: Array, expectation: Array, spread: Array) -> Array:
    """Return the logarithm of the certainty degree of every sample in every class, [K, N].

        log u = −max_l (z_l − Ex_l)² / (2 En'_l²)

    Args:
        samples: [N, D].
        expectation: [K, D] Ex.
        spread: [K, D], or [K, N, D] if it differs between samples: En' > 0.

    Example:
        >>> centres, spread = jnp.zeros((1, 2)), jnp.ones((1, 2))
        >>> print(log_certainty(jnp.array([[1.0, 2.0]]), centres, spread))
        [[-2.]]

    Source: clustering cloud-like model (2019), equations 2 and 11.

    Note:
        Equation 2 prints the sample's index under the minimum and no factor 2; read as 11.
    """
    return -safe_max(_squares(samples, expectation, spread)) / 2


def mean_log_certainty(
    samples: Array, expectation: Array, entropy: Array, hyper_entropy: Array, floor: Array
) -> Array:
    """Return the logarithm of the mean certainty degree over the random widths, [K, N].

        u = min_l E_ξ exp(−(z_l − Ex_l)² / (2 En'_l²)),   En' = max(|En + He ξ|, floor)

    by Gauss–Hermite quadrature with 16 nodes, axis by axis: the minimum is over the means.

    Args:
        samples: [N, D].
        expectation: [K, D] Ex.
        entropy: [K, D] En.
        hyper_entropy: [K, D] He.
        floor: [N, D] least width, positive.

    Example:
        >>> zero, one = jnp.zeros((1, 1)), jnp.ones((1, 1))
        >>> print(mean_log_certainty(one, zero, one, zero, 0.1 * one).round(3))
        [[-0.5]]

    Source: clustering cloud-like model (2019), section 3.1: "the mean of the certainty degree".
    """
    nodes = jnp.asarray(_NODES, samples.dtype)[:, None, None]
    width = floored_spread(entropy[None] + hyper_entropy[None] * nodes, floor)
    squares = _squares(samples, expectation, width)  # [16, K, N, D]
    weights = jnp.asarray(_LOG_NODE_WEIGHTS, samples.dtype).reshape(-1, 1, 1, 1)
    return -safe_max(-jax.nn.logsumexp(weights - squares / 2, axis=0))


def floored_spread(spread: Array, floor: Array) -> Array:
    """Return max(|En'|, floor) for all classes and samples, [..., K, N, D].

    Args:
        spread: [..., K, D] En'.
        floor: [N, D] least width of each sample.

    Example:
        >>> print(floored_spread(jnp.array([[-2.0], [0.1]]), jnp.array([[1.0]])).ravel())
        [2. 1.]
    """
    wide = jnp.abs(spread)[..., None, :]
    least = jnp.expand_dims(floor, tuple(range(wide.ndim - 2)))
    return jnp.where(wide > least, wide, least)


def cloud_cmeans(
    samples: Array,
    weights: Array,
    start: Array,
    *,
    centres: Array,
    floor: Array,
    allowed: Array | None = None,
    xi: Array | None = None,
    temperature: Array | float | None = None,
    tolerance: Array | float = 1e-6,
    iterations: int = 12,
) -> CloudMeans:
    """Return classes of samples, each a cloud: C-means with certainties for memberships.

    Samples go to the class in which they are most certain, each class becomes the cloud of its
    samples, which gives new certainties, until the objective stands still:

        J = Σ_ij w_j u_ij² ‖z_j − Ex_i‖²

    Args:
        samples: [N, D].
        weights: [N] ≥ 0.
        start: [K, N] logarithms of the certainties to start from.
        centres: [K, D] where a class without samples stands.
        floor: [N, D] least width En' of a class, as each sample sees it; positive.
        allowed: [K, N] which samples a class may have; all by default.
        xi: [K, D] standard normal draws of the widths; the mean certainty without.
        temperature: if given, classes share samples by a softmax of log u / temperature, and all
            iterations are made, so that the result is smooth; it tends to the crisp one as the
            temperature goes to 0.
        tolerance: iterations end when J changes by less, in the samples' unit squared.
        iterations: at most so many. Static.

    Raises:
        ValueError: shapes do not fit.
        TypeError: not real numbers, or `iterations` is not an int.

    Example:
        >>> samples = jnp.array([[0.0], [1.0], [10.0], [11.0]])
        >>> start = -jnp.abs(samples.T - jnp.array([[3.0], [7.0]]))
        >>> found = cloud_cmeans(samples, jnp.ones(4), start, centres=jnp.zeros((2, 1)),
        ...                      floor=jnp.ones((4, 1)))
        >>> print(found.cloud.expectation.ravel(), found.done)
        [ 0.5 10.5] True

    Source: clustering cloud-like model (2019), equations 2, 3, 11 and 12, steps 2 to 5.

    Note:
        The widths are drawn once, before the first iteration: drawn anew in each, the objective
        never settles in half of the cases. Step 5 returns to step 2 and not, as printed, to 1.
    """
    check_array("samples", samples, shape=("N", "D"))
    size, features = samples.shape
    check_array("weights", weights, shape=(size,))
    check_array("start", start, shape=("K", size))
    classes = start.shape[0]
    check_array("centres", centres, shape=(classes, features))
    check_array("floor", floor, shape=(size, features))
    check_size("iterations", iterations)
    allowed = jnp.ones((classes, size), bool) if allowed is None else allowed
    check_array("allowed", allowed, shape=(classes, size))
    if xi is not None:
        check_array("xi", xi, shape=(classes, features))
    dtype = samples.dtype
    bound = jnp.asarray(tolerance, dtype)

    def iterate(state: _State, _: None) -> tuple[_State, None]:
        members = _classes(state.log_u, allowed, temperature)
        cloud = jax.vmap(lambda share: backward(samples, weights * share))(members)
        empty = (cloud.mass <= 0)[:, None]
        cloud = cloud._replace(expectation=jnp.where(empty, centres, cloud.expectation))
        if xi is None:
            log_u = mean_log_certainty(samples, *cloud[:3], floor)
        else:
            width = floored_spread(cloud.entropy + cloud.hyper_entropy * xi, floor)
            log_u = log_certainty(samples, cloud.expectation, width)
        apart = ((samples[None] - cloud.expectation[:, None]) ** 2).sum(-1)
        u = jnp.where(allowed, jnp.exp(log_u), 0.0)
        objective = (weights[None, :] * u**2 * apart).sum()
        done = jnp.abs(jax.lax.stop_gradient(objective - state.objective)) < bound
        new = _State(log_u, cloud, members, u, objective, done)
        if temperature is not None:
            return new, None
        return jax.tree.map(lambda old, new: jnp.where(state.done, old, new), state, new), None

    nowhere = jnp.zeros((classes, features), dtype)
    nothing = jnp.zeros((classes, size), dtype)
    begin = _State(
        start.astype(dtype),
        Cloud(nowhere, nowhere, nowhere, jnp.zeros(classes, dtype)),
        nothing,
        nothing,
        jnp.asarray(jnp.inf, dtype),
        jnp.asarray(False),
    )
    last, _ = jax.lax.scan(iterate, begin, length=iterations)
    return CloudMeans(last.cloud, last.members, last.certainty, last.objective, last.done)


class _State(NamedTuple):
    log_u: Array
    cloud: Cloud
    members: Array
    certainty: Array
    objective: Array
    done: Array


def _squares(samples: Array, expectation: Array, spread: Array) -> Array:
    """Return (z − Ex)² / En'², [..., K, N, D]."""
    apart = samples[None] - expectation[:, None]
    width = spread[:, None] if spread.ndim == 2 else spread
    return (apart.reshape((1,) * (width.ndim - 3) + apart.shape) / width) ** 2


def _classes(log_u: Array, allowed: Array, temperature: Array | float | None) -> Array:
    """Return the share [K, N] of every sample in every class; none where nothing is allowed."""
    some = allowed.any(0)[None, :]
    if log_u.shape[0] == 0:
        return jnp.zeros_like(log_u)
    lowest = jnp.asarray(jnp.finfo(log_u.dtype).min / 4, log_u.dtype)
    known = jnp.where(allowed, log_u, lowest)
    if temperature is None:
        best = jnp.argmax(known, axis=0)
        share = (jnp.arange(log_u.shape[0])[:, None] == best[None, :]).astype(log_u.dtype)
    else:
        scaled = known / jnp.asarray(temperature, log_u.dtype)
        peak = jnp.where(allowed, jax.lax.stop_gradient(scaled), -jnp.inf).max(0)
        shifted = jnp.where(allowed, scaled - jnp.where(some[0], peak, 0.0)[None, :], 0.0)
        power = jnp.where(allowed, jnp.exp(shifted), 0.0)
        share = safe_divide(power, power.sum(0)[None, :])
    return jnp.where(some, share, 0.0)
