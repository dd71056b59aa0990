"""A window estimator that runs along with the looks."""

from collections.abc import Callable
from typing import Any, Generic, NamedTuple, TypeVar

import jax
import jax.numpy as jnp

from jaxtrack.numerics.checks import check_size
from jaxtrack.types import Array, Estimator, InfoT, Key, Lines, ScanT, Tracks

FoundT = TypeVar("FoundT", bound=Tracks | Lines)


class SlidingInfo(NamedTuple, Generic[FoundT, InfoT]):
    """What people look at."""

    tracks: FoundT  # of the window that ends with the last valid look
    info: InfoT  # the window estimator's
    looks: Array  # [] valid looks in the window


def sliding(
    estimate: Callable[[ScanT], tuple[FoundT, InfoT]], *, like: ScanT, window: int
) -> Estimator[ScanT, ScanT, SlidingInfo[FoundT, InfoT]]:
    """Return the estimator whose every step looks at the last valid looks at once.

    Its state is these looks, stacked, oldest first; until there are enough the front of the window
    holds looks that are not valid. A look that is not valid itself changes nothing.

    Args:
        estimate: the window estimator, its parameters bound: `scans [W, ...] -> (tracks, info)`.
        like: one look of the kind that will come: its shapes and dtypes count, its values do not.
        window: W, looks.

    Raises:
        TypeError: `window` is not a Python int.
        ValueError: `window` is below 1.

    Example:
        >>> from jaxtrack.types import Scan
        >>> def last_seen(scans):
        ...     return Lines(*scans.position_m[:, 0].T, jnp.ones(3), scans.valid), None
        >>> scans = Scan(jnp.arange(4.0), jnp.array([True, True, False, True]),
        ...              jnp.arange(8.0).reshape(4, 1, 2), jnp.ones((4, 1), bool))
        >>> one = jax.tree.map(lambda x: x[0], scans)
        >>> tracker = sliding(last_seen, like=one, window=3)
        >>> _, info = jax.lax.scan(tracker.step, tracker.init(jax.random.key(0)), scans)
        >>> print(info.tracks.rho_m[-1], info.looks)
        [0. 2. 6.] [1 2 2 3]
    """
    check_size("window", window)

    def init(key: Key) -> ScanT:
        return jax.tree.map(lambda x: jnp.zeros((window, *jnp.shape(x)), jnp.result_type(x)), like)

    def step(state: ScanT, scan: ScanT) -> tuple[ScanT, SlidingInfo[FoundT, InfoT]]:
        valid = _valid(scan)
        push = lambda kept, x: jnp.where(valid, jnp.concatenate([kept[1:], x[None]]), kept)
        state = jax.tree.map(push, state, scan)
        return state, SlidingInfo(*estimate(state), _valid(state).sum())

    return Estimator(init, step)


def _valid(scan: Any) -> Array:
    return scan.valid
