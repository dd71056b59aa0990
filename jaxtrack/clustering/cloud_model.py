"""The cloud model: classes that are both fuzzy and random.

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


def _squares(samples: Array, expectation: Array, spread: Array) -> Array:
    """Return (z − Ex)² / En'², [..., K, N, D]."""
    apart = samples[None] - expectation[:, None]
    width = spread[:, None] if spread.ndim == 2 else spread
    return (apart.reshape((1,) * (width.ndim - 3) + apart.shape) / width) ** 2
