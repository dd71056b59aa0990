"""A fit on disk: what it takes to go on with it, and nothing that could be mistaken for another's.

One file holds the leaves of the state; its structure is that of the call that reads it. A digest of
the arguments says whose it is.
"""

import hashlib
import pathlib
import zipfile
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from jaxtrack.types import Key

FILE = "fit.npz"


def digest(key: Key, tree: Any, *settings: Any) -> str:
    """Return what tells one fit from another: its key, where it starts, its settings.

    Args:
        key: of the fit.
        tree: pytree of arrays.
        settings: anything whose `repr` says what it is.

    Example:
        >>> key = jax.random.key(0)
        >>> digest(key, {"gate": 1.0}, 8) == digest(key, {"gate": 2.0}, 8)
        False
    """
    hashed = hashlib.sha256(f"{jax.tree.structure(tree)} {settings!r}".encode())
    for leaf in (jax.random.key_data(key), *jax.tree.leaves(tree)):
        array = _plain(leaf)
        hashed.update(f"{array.dtype}{array.shape}".encode() + array.tobytes())
    return hashed.hexdigest()


def write(folder: pathlib.Path, made_by: str, state: Any) -> None:
    """Write a state, replacing the one before at once: a run that dies here leaves the old one.

    Example:
        >>> import tempfile
        >>> with tempfile.TemporaryDirectory() as folder:
        ...     write(pathlib.Path(folder), "me", {"step": np.int64(3)})
        ...     state = read(pathlib.Path(folder), "me", {"step": np.int64(0)})
        >>> int(state["step"])
        3
    """
    folder.mkdir(parents=True, exist_ok=True)
    leaves: dict[str, Any] = {
        f"leaf_{n}": _plain(leaf) for n, leaf in enumerate(jax.tree.leaves(state))
    }
    half = folder / f"half_{FILE}"
    np.savez(half, made_by=made_by, **leaves)
    half.replace(folder / FILE)


def read(folder: pathlib.Path, made_by: str, like: Any) -> Any | None:
    """Return the state that stands in a folder, or None if there is none.

    Args:
        folder: where `write` put it.
        made_by: digest of the call that wants to go on.
        like: a state of the same structure; shapes may differ.

    Raises:
        ValueError: it is another fit's, or broken, or the folder is a file.

    Example:
        >>> read(pathlib.Path("nowhere"), "me", {"step": 0}) is None
        True
    """
    if folder.exists() and not folder.is_dir():
        raise ValueError(f"checkpoint: got {folder}, which is a file, want a folder")
    file = folder / FILE
    if not file.exists():
        return None
    want = "want that of a fit with the same key, parameters and settings, or an empty folder"
    try:
        with file.open("rb") as opened, np.load(opened) as kept:
            arrays = dict(kept)
    except (OSError, EOFError, TypeError, ValueError, zipfile.BadZipFile) as error:
        raise ValueError(f"checkpoint: got {file}, which is broken ({error}), {want}") from error
    leaves, structure = jax.tree.flatten(like)
    if str(arrays.get("made_by")) != made_by or len(arrays) != len(leaves) + 1:
        raise ValueError(f"checkpoint: got {file} of another fit, {want}")
    again = lambda x, was: jax.random.wrap_key_data(x) if _is_key(was) else x
    found = [again(arrays[f"leaf_{n}"], leaf) for n, leaf in enumerate(leaves)]
    return structure.unflatten(found)


def _plain(leaf: Any) -> np.ndarray:
    """Return a leaf in NumPy; some optimizers draw noise, and keep a key for it."""
    return np.asarray(jax.random.key_data(leaf) if _is_key(leaf) else leaf)


def _is_key(leaf: Any) -> bool:
    return isinstance(leaf, jax.Array) and jnp.issubdtype(leaf.dtype, jax.dtypes.prng_key)
