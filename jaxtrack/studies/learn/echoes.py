"""The true likelihood ratio of an echo in correlated K-distributed clutter.

The texture τ of the clutter is a Markov chain over the beams: it is the mean square of d = 2ν
Gaussians (`sensors.echoes`), and with φ² = e^(−1/ℓ)

    d τ_{b+1} / (1 − φ²)  ~  noncentral χ²_d,   λ = d φ² τ_b / (1 − φ²).

Given τ a clutter's amplitude is Rayleigh, a target's Rician,

    p_C(a | τ) = 2a/τ e^(−a²/τ),    p_T(a | τ) = p_C(a | τ) e^(−s²/τ) I₀(2as/τ),   s = √SNR.

So a sum over a grid of τ, forward and backward over a look's beams, gives what every other echo of
the look tells about the texture in a beam, and with it p(a_b | target, others) / p(a_b | clutter,
others). No estimator that sees amplitudes alone knows more.
"""

import functools

import jax
import jax.numpy as jnp
import numpy as np

from jaxtrack.numerics.safe import safe_log
from jaxtrack.sensors import Echo
from jaxtrack.types import Array

DEGREES = 1  # d; the chain's Bessel function, of order −1/2, is elementary
_GRID = 40
_TEXTURES = (1e-4, 12.0)  # beyond them lie 1e-3 and 1e-4 of the probability


def echo_log_ratio(amplitude: Array, mask: Array, echo: Echo, share: Array | float) -> Array:
    """Return log p(a | target, others) − log p(a | clutter, others) of every echo, [T, B].

    Args:
        amplitude: [T, B] of the beams that report something.
        mask: [T, B] which do; 0 is returned for the others.
        echo: signal-to-noise ratio, and the clutter's correlation.
        share: of reports that are a target's, from 0 to 1: what the others may be.

    Example:
        >>> amplitude = jnp.array([[0.5, 0.6, 4.0, 0.5], [3.0, 2.6, 4.0, 3.5]])
        >>> ratio = echo_log_ratio(amplitude, jnp.ones((2, 4), bool), Echo(12.0), 0.1)
        >>> faint, loud = ratio[:, 2]  # the same echo among faint and among loud clutter
        >>> print(f"{faint:.1f} {loud:.1f}")
        7.3 1.8
    """
    dtype = amplitude.dtype
    texture, stationary, chain = _chain(jnp.asarray(echo.correlation_beams, dtype))
    a, tau = jnp.where(mask, amplitude, 1.0)[..., None], texture[None, None]
    signal = 10 ** (jnp.asarray(echo.snr_db, dtype) / 20)
    clutter = safe_log(2 * a / tau) - a**2 / tau
    both = 2 * a * signal / tau
    target = clutter - signal**2 / tau + jnp.log(jax.scipy.special.i0e(both)) + both
    share = jnp.asarray(share, dtype)
    mixture = (1 - share) * jnp.exp(clutter) + share * jnp.exp(target)
    likely = jnp.where(mask[..., None], mixture, 1.0)  # [T, B, G]

    def step(table: Array, belief: Array, seen: Array) -> tuple[Array, Array]:
        after = (belief * seen) @ table
        return after / after.sum(-1, keepdims=True), belief

    beams = jnp.swapaxes(likely, 0, 1)
    begin = jnp.broadcast_to(stationary, beams.shape[1:])
    onward, back = functools.partial(step, chain), functools.partial(step, chain.T)
    _, before = jax.lax.scan(onward, begin, beams)
    _, behind = jax.lax.scan(back, jnp.ones_like(begin), beams, reverse=True)
    others = jnp.swapaxes(before * behind, 0, 1)
    given = lambda density: safe_log((others * jnp.exp(density)).sum(-1))
    return jnp.where(mask, given(target) - given(clutter), 0.0)


def _chain(correlation_beams: Array) -> tuple[Array, Array, Array]:
    """Return the grid of textures, their stationary distribution and the chain's, rows from."""
    dtype = correlation_beams.dtype
    edges = np.geomspace(*_TEXTURES, _GRID + 1)
    texture, width = jnp.asarray(np.sqrt(edges[1:] * edges[:-1]), dtype), np.diff(edges)
    half = DEGREES / 2
    kept = jnp.exp(-1 / correlation_beams)  # φ²
    of, scale = DEGREES * texture, 1 - kept
    x, noncentrality = of[None] / scale, (kept * of / scale)[:, None]
    root = jnp.sqrt(x * noncentrality)
    bessel = (1 + jnp.exp(-2 * root)) / jnp.sqrt(x)
    rows = jnp.exp(root - (x + noncentrality) / 2) * bessel * jnp.asarray(width, dtype)[None]
    gamma = texture ** (half - 1) * jnp.exp(-half * texture) * jnp.asarray(width, dtype)
    return texture, gamma / gamma.sum(), rows / rows.sum(1, keepdims=True)
