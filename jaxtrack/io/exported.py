"""Estimators as files that run where this library is not installed.

JAX writes and reads them with the package flatbuffers (extra `export`).
"""

from collections.abc import Callable
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from jaxtrack.types import Array


def export_estimator(fn: Callable[..., Any], *like: Any) -> bytes:
    """Return a compiled-ahead function as bytes that JAX runs by itself.

        run = jax.export.deserialize(bytearray(content))
        result = run.call({"0.time_s": …, "0.position_m": …})

    What goes in and comes out are dictionaries of arrays, named as fields are: `"0.mask"` is the
    field `mask` of the first argument (`named_arrays` makes them); `"mean"` one of a result,
    `"1.tracks.mean"` one of the second of several. The other side need not know any types.

    A whole run is a function of stacked looks; an estimator that runs along with them is exported
    as `estimator.step`, whose results `"0.…"` are the next call's arguments `"0.…"`.

    Args:
        fn: a pure function of pytrees of arrays, its parameters bound.
        like: arguments of the shapes and dtypes that will come; values do not count.

    Returns:
        The content of a file, for the kind of device that exported it. Later versions of JAX read
        it too (see `jax.export` for how long); dtypes of 64 bit want `jax_enable_x64` there.

    Raises:
        ImportError: flatbuffers is not installed.
        TypeError: `fn` is not callable, or there is nothing that will come.

    Example:
        >>> from jaxtrack.types import Scan
        >>> scans = Scan(jnp.arange(3.0), jnp.ones(3, bool), jnp.zeros((3, 1, 2)),
        ...              jnp.ones((3, 1), bool))
        >>> mean = lambda scans: {"mean_m": scans.position_m.mean((0, 1))}
        >>> run = jax.export.deserialize(bytearray(export_estimator(mean, scans)))
        >>> print(run.call(named_arrays(scans))["mean_m"])
        [0. 0.]
    """
    if not callable(fn):
        raise TypeError(f"fn: got {type(fn).__name__}, want a function of pytrees of arrays")
    leaves, structure = jax.tree.flatten(like)
    if not leaves:
        raise TypeError("like: got no arrays, want arguments of the shapes that will come")
    shapes = {
        name: jax.ShapeDtypeStruct(jnp.shape(x), jnp.result_type(x))
        for name, x in _named(like).items()
    }

    def of_arrays(arrays: dict[str, Array]) -> dict[str, Array]:
        given = (arrays[name] for name in shapes)
        again = [
            jax.random.wrap_key_data(x, impl=jax.random.key_impl(was)) if _is_key(was) else x
            for x, was in zip(given, leaves, strict=True)
        ]
        return _named(fn(*structure.unflatten(again)))

    return bytes(jax.export.export(jax.jit(of_arrays))(shapes).serialize())


def named_arrays(*arguments: Any) -> dict[str, np.ndarray]:
    """Return the arrays that an exported function takes, by name, in NumPy: `np.savez` keeps them.

    Args:
        arguments: as of the function that was exported; random keys become their data.

    Example:
        >>> from jaxtrack.types import Pose
        >>> list(named_arrays(Pose(jnp.zeros(2), jnp.array(0.0)), jax.random.key(0)))
        ['0.position_m', '0.heading_rad', '1']
    """
    return {name: np.asarray(x) for name, x in _named(arguments).items()}


def _named(tree: Any) -> dict[str, Any]:
    name = lambda path: jax.tree_util.keystr(path, simple=True, separator=".")
    data = lambda x: jax.random.key_data(x) if _is_key(x) else x
    return {name(path): data(leaf) for path, leaf in jax.tree.leaves_with_path(tree)}


def _is_key(leaf: Any) -> bool:
    return isinstance(leaf, jax.Array) and jnp.issubdtype(leaf.dtype, jax.dtypes.prng_key)
