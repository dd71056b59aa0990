"""How loud an echo is: a steady target in K-distributed clutter.

    a = |√SNR · [target] + √τ s|,  s ~ CN(0, 1),  τ ~ Gamma(ν, 1/ν)

Without a target a is K-distributed with E a² = 1: speckle s, alike in every sea state, rides on the
texture τ, the patches of stronger and weaker reverberation. The texture is a mean of squares,

    τ_b = 1/(2ν) Σ_{i ≤ 2ν} g_ib²,  g_ib = φ g_{i,b−1} + √(1 − φ²) n_ib,  φ = e^(−1/2ℓ),

exactly gamma-distributed in every beam; its correlation over d beams is φ^2d = e^(−d/ℓ).
"""

from typing import NamedTuple

import jax
import jax.numpy as jnp

from jaxtrack.numerics.checks import check_array, check_known, check_size
from jaxtrack.numerics.safe import safe_norm, safe_sqrt
from jaxtrack.types import Array, Key


class Echo(NamedTuple):
    """How loud targets are, and how far clutter is alike. Traced."""

    snr_db: Array | float = 12.0  # a target's power over the clutter's mean power
    correlation_beams: Array | float = 3.0  # ℓ > 0, where the texture's correlation is 1/e


def echo_amplitudes(
    key: Key, target: Array, echo: Echo, *, degrees: int = 4, dtype: jnp.dtype
) -> Array:
    """Return the amplitude in every beam of every look, [T, B], the clutter's mean power being 1.

    Looks are independent of each other. No threshold is modelled: the amplitude of a false alarm
    is that of any clutter.

    Args:
        key: random key.
        target: [T, B] where a target's echo is.
        echo: signal-to-noise ratio, and the clutter's correlation.
        degrees: 2ν, of the clutter's texture, static: few are spiky, many near Rayleigh clutter.
        dtype: of the amplitudes.

    Example:
        >>> target = jnp.array([[False] * 50, [True] * 50])
        >>> loud = echo_amplitudes(jax.random.key(0), target, Echo(30.0), dtype=jnp.float32)
        >>> print(loud[0].mean() < 2.0, (loud[1] > 10.0).all())
        True True

    Source: the compound form of the K distribution.
    """
    check_array("target", target, shape=("T", "B"))
    check_size("degrees", degrees)
    looks, beams = target.shape
    keys = jax.random.split(key)
    phi = jnp.exp(-0.5 / jnp.asarray(echo.correlation_beams, dtype))
    fresh = jax.random.normal(keys[0], (beams, looks, degrees), dtype)

    def step(g: Array, n: Array) -> tuple[Array, Array]:
        g = phi * g + jnp.sqrt(1 - phi**2) * n
        return g, (g**2).mean(axis=-1)

    _, rest = jax.lax.scan(step, fresh[0], fresh[1:])
    texture = jnp.concatenate([(fresh[:1] ** 2).mean(axis=-1), rest]).T
    signal = 10 ** (jnp.asarray(echo.snr_db, dtype) / 20) * target.astype(dtype)
    return _heard(keys[1], signal, texture)


def reverberate(key: Key, power: Array, *, shape: int = 3) -> Array:
    """Return the amplitude in every cell, [...]: steady echoes in K-distributed reverberation.

        a = |√p + √τ s|,   τ = −1/ν log Π_{i ≤ ν} u_i,   u_i ~ U(0, 1)

    Cells are independent of each other; the reverberation's mean power is 1. The texture is a mean
    of ν exponentials, so gamma-distributed, and cheaper than one that is correlated.

    Args:
        key: random key; one of `impl="rbg"` is faster on a CPU.
        power: [...] of the echoes in each cell, p ≥ 0.
        shape: ν of the texture, static, up to 32: few are spiky, many near Rayleigh reverberation.

    Raises:
        ValueError: a shape beyond 32, whose product of uniforms could vanish in float32.

    Example:
        >>> loud = reverberate(jax.random.key(0), jnp.array([[0.0] * 50, [1e4] * 50]))
        >>> print(loud[0].mean() < 2.0, (loud[1] > 80.0).all())
        True True

    Source: the compound form of the K distribution.
    """
    check_array("power", power)
    check_size("shape", shape)
    check_known("shape", shape, lambda nu: nu <= 32, "an int ≤ 32")
    keys = jax.random.split(key)
    uniform = 1 - jax.random.uniform(keys[0], (shape, *power.shape), power.dtype)  # never 0
    texture = -jnp.log(uniform.prod(axis=0)) / shape
    return _heard(keys[1], safe_sqrt(power), texture)


def _heard(key: Key, signal: Array, texture: Array) -> Array:
    """Return |signal + √τ s| for a signal's amplitude and the clutter's texture, of one shape."""
    speckle = jax.random.normal(key, (*texture.shape, 2), texture.dtype)
    clutter = jnp.sqrt(texture / 2)[..., None] * speckle
    return safe_norm(clutter + jnp.stack([signal, jnp.zeros_like(signal)], axis=-1))
