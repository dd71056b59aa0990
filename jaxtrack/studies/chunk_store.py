"""The store of a study's trials: made, opened, mended, and made to hold more of them."""

import contextlib
import pathlib
import secrets
import shutil
from collections.abc import Iterator, Mapping
from typing import Any

import numpy as np
import zarr
from zarr.codecs import Crc32cCodec, ZstdCodec

from jaxtrack.studies import chunks
from jaxtrack.studies.chunks import COMMITS, HALF, Chunks, Variable, place, sync
from jaxtrack.studies.store import RESULTS
from jaxtrack.studies.study_file import StudyError

FORMAT = 2


def create(
    folder: pathlib.Path,
    variables: Mapping[str, Variable],
    *,
    trials: int,
    chunk: int,
    attributes: Mapping[str, Any],
) -> Chunks:
    """Make the folder of a study, without any trial yet.

    Raises:
        StudyError: the folder cannot be written.

    Example:
        >>> import tempfile
        >>> with tempfile.TemporaryDirectory() as folder:
        ...     about = {"mean.error_m": Variable(("sigma_m",), (3,), "float32")}
        ...     store = create(pathlib.Path(folder), about, trials=10, chunk=4, attributes={})
        ...     chunks.write(store, 0, {"mean.error_m": np.zeros((3, 4), np.float32)})
        ...     print(store.count, chunks.committed(store), chunks.read(store, 1))
        3 {0} None
    """
    try:
        (folder / COMMITS).mkdir(parents=True, exist_ok=True)
        with _half(folder, variables, trials, chunk, attributes) as half:
            half.rename(folder / RESULTS)
        sync([folder])
    except OSError as error:
        if (folder / RESULTS).exists():
            raise StudyError(f"{folder}: another run began there at the same time") from error
        raise StudyError(f"{folder}: cannot be made: {error.strerror or error}") from error
    return open_chunks(folder)


def amend(store: Chunks, *, trials: int, attributes: Mapping[str, Any]) -> Chunks:
    """Make anew what is missing of a store but its chunks, and let it hold more trials.

    Only descriptions of arrays are replaced, the store's own last; chunks stay as they are, but for
    a last one that is to be longer.

    Raises:
        StudyError: the folder cannot be written.

    Example:
        >>> import tempfile
        >>> with tempfile.TemporaryDirectory() as folder:
        ...     about = {"mean.found": Variable((), (), "bool")}
        ...     store = create(pathlib.Path(folder), about, trials=4, chunk=4, attributes={})
        ...     chunks.write(store, 0, {"mean.found": np.ones(4, bool)})
        ...     store = amend(store, trials=10, attributes={})
        ...     print(store.count, chunks.read(store, 0)["mean.found"].sum())
        3 4
    """
    results = store.folder / RESULTS
    try:
        if trials > store.trials and store.trials % store.chunk:
            chunks.remove(store, store.count - 1)
        with _half(store.folder, store.variables, trials, store.chunk, attributes) as half:
            folders = [half, *(path for path in half.rglob("*") if path.is_dir())]
            there = {path: results / path.relative_to(half) for path in folders}
            for path in there.values():
                path.mkdir(exist_ok=True)
            for path in (*(half / name for name in store.variables), half):
                (path / "zarr.json").replace(there[path] / "zarr.json")
            sync(there.values())
    except OSError as error:
        reason = error.strerror or error
        raise StudyError(f"{store.folder}: cannot be written: {reason}") from error
    return open_chunks(store.folder)


@contextlib.contextmanager
def _half(
    folder: pathlib.Path,
    variables: Mapping[str, Variable],
    trials: int,
    chunk: int,
    attributes: Mapping[str, Any],
) -> Iterator[pathlib.Path]:
    """Make a store under another name, which is gone afterwards."""
    half = folder / f"{HALF}{RESULTS}.{secrets.token_hex(4)}"  # two may begin at once
    told = {
        "format": FORMAT,
        "trials": trials,
        "chunk": chunk,
        "variables": {name: variable._asdict() for name, variable in variables.items()},
    }
    try:
        group = zarr.create_group(half, zarr_format=3, attributes={**attributes, **told})
        for name, variable in variables.items():
            dtype = np.dtype(variable.dtype)
            group.create_array(
                name,
                shape=(*variable.shape, trials),
                chunks=(*variable.shape, chunk),
                dtype=dtype,
                fill_value=np.nan if dtype.kind == "f" else 0,
                compressors=(ZstdCodec(level=3), Crc32cCodec()),
                dimension_names=(*variable.dims, "trial"),
            )
            (half / name / place(variable, 0)).parent.mkdir(
                parents=True
            )  # here, where it is synced
        sync([*half.rglob("*"), half])
        yield half
    finally:
        shutil.rmtree(half, ignore_errors=True)


def open_chunks(folder: pathlib.Path) -> Chunks:
    """Open the folder of a study.

    Raises:
        StudyError: there is none, or it is of another version or broken.

    Example:
        >>> open_chunks(pathlib.Path("nowhere"))
        Traceback (most recent call last):
        jaxtrack.studies.study_file.StudyError: nowhere: there is no study here
    """
    results = folder / RESULTS
    if not results.exists():
        raise StudyError(f"{folder}: there is no study here")
    try:
        attributes = dict(zarr.open_group(results, mode="r+", zarr_format=3).attrs)
    except Exception as error:  # whatever zarr makes of a broken file
        reason = " ".join(str(error).split())
        only = "it alone tells what the chunks are: restore it, or begin in another folder"
        raise StudyError(f"{results / 'zarr.json'}: cannot be read: {reason}; {only}") from error
    if "format" not in attributes:
        raise StudyError(f"{folder}: holds results, but not those of a study's file")
    if attributes["format"] != FORMAT:
        kind = f"has format {attributes['format']}, this version of jaxtrack reads {FORMAT}"
        raise StudyError(f"{folder}: the store {kind}")
    store = Chunks(folder, 0, 0, attributes, {}, {})
    variables = {
        name: Variable(tuple(known["dims"]), tuple(known["shape"]), known["dtype"])
        for name, known in store.attribute("variables").items()
    }
    store = store._replace(
        trials=store.attribute("trials"), chunk=store.attribute("chunk"), variables=variables
    )
    arrays = {name: _array(store, name) for name in variables}
    return store._replace(arrays={name: a for name, a in arrays.items() if a is not None})


def _array(store: Chunks, name: str) -> zarr.Array[Any] | None:
    """Return an array; None if it is missing, or not what it should be."""
    variable = store.variables[name]
    try:
        # What equals the fill value is written too, so that a file that is lost is missed.
        with zarr.config.set({"array.write_empty_chunks": True}):
            array = zarr.open_array(store.folder / RESULTS / name, mode="r+", zarr_format=3)
    except Exception:  # whatever zarr makes of a broken file
        return None
    wanted = ((*variable.shape, store.trials), (*variable.shape, store.chunk), variable.dtype)
    return array if (array.shape, array.chunks, str(array.dtype)) == wanted else None
