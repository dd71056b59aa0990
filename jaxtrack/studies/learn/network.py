"""A small network that looks at a sonar's echoes and says which may be a target's.

Two convolutions along the beams: what a beam reports is seen beside what its neighbours do, so that
loud clutter can be told from a loud echo in faint clutter. Needs Flax (extra `learn`).
"""

from collections.abc import Callable
from typing import Any

import jax
import jax.numpy as jnp
from flax import nnx

from jaxtrack.numerics.safe import safe_log
from jaxtrack.types import Array, BeamScan, Key

_REACH = (15, 9)  # beams that the convolutions see
_LEAST = 1e-2  # amplitudes below it look alike


class EchoNetwork(nnx.Module):
    """Log-odds for every beam of every look, from features [T, B, F]."""

    def __init__(self, features: int, width: int, *, rngs: nnx.Rngs):
        dtype = {"param_dtype": jnp.result_type(float), "rngs": rngs}
        self.near = nnx.Conv(features, width, _REACH[:1], **dtype)
        self.far = nnx.Conv(width, width, _REACH[1:], **dtype)
        # Zeros: to begin with every echo counts alike.
        self.out = nnx.Linear(width, 1, kernel_init=nnx.initializers.zeros, **dtype)

    def __call__(self, x: Array) -> Array:
        """Return log-odds [T, B]."""
        hidden = nnx.relu(self.near(x))
        hidden = hidden + nnx.relu(self.far(hidden))
        return self.out(hidden)[..., 0]


def features_of(scans: BeamScan, range_max_m: Array | float) -> Array:
    """Return what the network sees, [T, B, 4]: echo, log amplitude, range, bearing.

    Example:
        >>> from jaxtrack.types import Pose
        >>> scans = BeamScan(jnp.zeros(1), jnp.ones(1, bool), jnp.array([[75.0, 0.0]]),
        ...                  jnp.array([[True, False]]), Pose(jnp.zeros((1, 2)), jnp.zeros(1)),
        ...                  intensity=jnp.array([[1.0, 0.0]]))
        >>> print(features_of(scans, 150.0)[0])
        [[ 1.  0.  0. -1.]
         [ 0.  0.  0.  1.]]
    """
    assert scans.intensity is not None
    dtype = scans.range_m.dtype
    there = (scans.mask & scans.valid[:, None]).astype(dtype)
    loud = there * safe_log(jnp.where(there > 0, scans.intensity, 1.0), _LEAST)
    far = jnp.where(there > 0, 2 * scans.range_m / jnp.asarray(range_max_m, dtype) - 1, 0.0)
    bearing = jnp.broadcast_to(jnp.linspace(-1, 1, there.shape[1], dtype=dtype)[None], there.shape)
    return jnp.stack([there, loud, far, bearing], axis=-1)


def echo_network(
    key: Key, *, width: int = 16
) -> tuple[dict[str, Any], Callable[[dict[str, Any], Array], Array]]:
    """Return first parameters, a dictionary of arrays, and the network as a pure function.

    Args:
        key: random key.
        width: channels of the hidden layers, static.

    Example:
        >>> params, network = echo_network(jax.random.key(0))
        >>> network(params, jnp.ones((2, 12, 4))).shape
        (2, 12)
    """
    graph, state = nnx.split(EchoNetwork(4, width, rngs=nnx.Rngs(key)))
    params = nnx.to_pure_dict(state)

    def network(params: dict[str, Any], x: Array) -> Array:
        # Its values are exchanged, its structure is what counts.
        now = jax.tree.map(lambda value: value, state)
        nnx.replace_by_pure_dict(now, params)
        return nnx.merge(graph, now)(x)

    return params, network
