"""How loud a beam's echo is: a steady target in K-distributed clutter, correlated along the beams.

    a = |√SNR · [target] + √τ s|,  s ~ CN(0, 1),  τ ~ Gamma(ν, 1/ν)

Without a target a is K-distributed with E a² = 1: speckle s, alike in every sea state, rides on the
texture τ, the patches of stronger and weaker reverberation. The texture follows an autoregression
along the beams whose every value is exactly gamma-distributed,

    τ_b = β_b τ_{b−1} + γ_b,  β ~ Beta(νc, ν(1 − c)),  γ ~ Gamma(ν(1 − c), 1/ν),  c = e^(−1/ℓ),

so that its correlation over d beams is c^d.
"""

from typing import NamedTuple

import jax
import jax.numpy as jnp

from jaxtrack.numerics.checks import check_array
from jaxtrack.numerics.safe import safe_divide, safe_norm
from jaxtrack.types import Array, Key


class Echo(NamedTuple):
    """How loud targets and clutter are. Traced."""

    snr_db: Array | float = 12.0  # a target's power over the clutter's mean power
    shape: Array | float = 2.0  # ν > 0: small is spiky, large is Rayleigh
    correlation_beams: Array | float = 3.0  # ℓ > 0, of the texture, to 1/e


def echo_amplitudes(key: Key, target: Array, echo: Echo, *, dtype: jnp.dtype) -> Array:
    """Return the amplitude in every beam of every look, [T, B], the clutter's mean power being 1.

    Looks are independent of each other. No threshold is modelled: the amplitude of a false alarm
    is that of any clutter.

    Args:
        key: random key.
        target: [T, B] where a target's echo is.
        echo: signal-to-noise ratio, and the clutter's shape and correlation.
        dtype: of the amplitudes.

    Example:
        >>> target = jnp.array([[False] * 50, [True] * 50])
        >>> loud = echo_amplitudes(jax.random.key(0), target, Echo(30.0), dtype=jnp.float32)
        >>> print(loud[0].mean() < 2.0, (loud[1] > 10.0).all())
        True True

    Source: the compound form of the K distribution; the texture after Lewis, McKenzie and Hugus,
    Gamma processes (1989).
    """
    check_array("target", target, shape=("T", "B"))
    looks, beams = target.shape
    keys = jax.random.split(key)
    shape = jnp.asarray(echo.shape, dtype)
    kept = jnp.exp(-1 / jnp.asarray(echo.correlation_beams, dtype))
    shapes = shape * jnp.stack([kept, 1 - kept, 1 - kept])
    shapes = jnp.broadcast_to(shapes[None, :, None], (beams, 3, looks))
    first, second, fresh = jnp.moveaxis(jax.random.gamma(keys[0], shapes, dtype=dtype), 1, 0)
    share = safe_divide(first, first + second)

    def step(texture: Array, inputs: tuple[Array, Array]) -> tuple[Array, Array]:
        texture = inputs[0] * texture + inputs[1]
        return texture, texture

    start = first[0] + second[0]  # Gamma(ν), and beam 0 has no other use for them
    _, rest = jax.lax.scan(step, start, (share[1:], fresh[1:]))
    texture = jnp.concatenate([start[None], rest]).T / shape
    speckle = jax.random.normal(keys[1], (looks, beams, 2), dtype)
    # The texture may underflow to zero, where a square root has no gradient.
    tiny = jnp.finfo(dtype).tiny
    clutter = jnp.sqrt(jnp.maximum(texture, tiny) / 2)[..., None] * speckle
    signal = 10 ** (jnp.asarray(echo.snr_db, dtype) / 20) * target.astype(dtype)
    return safe_norm(clutter + jnp.stack([signal, jnp.zeros_like(signal)], axis=-1))
