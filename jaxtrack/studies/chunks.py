"""Trials on disk, chunk by chunk, so that a study that dies anywhere loses one chunk at most.

results.zarr/<method>.<metric>    an array [grid …, trial], one file a chunk
commits/00000003.json             that chunk 3 is whole, with checksums of all its variables

A chunk counts once its commit record is there. The record is written last, after everything else
has reached the disk. Chunks share nothing, so that several processes write their own.
"""

import contextlib
import hashlib
import json
import os
import pathlib
import re
import secrets
import shutil
import tempfile
from collections.abc import Iterable, Mapping, MutableMapping
from typing import Any, NamedTuple

import numpy as np
import xarray as xr
import zarr
from zarr.codecs import Crc32cCodec, ZstdCodec

from jaxtrack.studies.store import RESULTS
from jaxtrack.studies.study_file import StudyError

FORMAT = 1
COMMITS = "commits"
_HALF = "half_"  # how names begin of what is not whole yet


class Variable(NamedTuple):
    """One array: what it has in front of the trials."""

    dims: tuple[str, ...]
    shape: tuple[int, ...]
    dtype: str


class Chunks(NamedTuple):
    """A study's folder."""

    folder: pathlib.Path
    trials: int
    chunk: int
    attributes: MutableMapping[str, Any]  # what is set goes to the disk
    arrays: dict[str, zarr.Array[Any]]

    @property
    def count(self) -> int:
        """How many chunks there are to be."""
        return -(-self.trials // self.chunk)

    def span(self, number: int) -> tuple[int, int]:
        """Return the first trial of a chunk, and the first that is not of it."""
        return number * self.chunk, min((number + 1) * self.chunk, self.trials)


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
        ...     write(store, 0, {"mean.error_m": np.zeros((3, 4), np.float32)})
        ...     print(store.count, committed(store), read(store, 1))
        3 {0} None
    """
    half = folder / f"{_HALF}{RESULTS}.{secrets.token_hex(4)}"  # two may begin at once
    try:
        (folder / COMMITS).mkdir(parents=True, exist_ok=True)
        group = zarr.create_group(half, zarr_format=3, attributes={"format": FORMAT, **attributes})
        for name, variable in variables.items():
            dtype = np.dtype(variable.dtype)
            array = group.create_array(
                name,
                shape=(*variable.shape, trials),
                chunks=(*variable.shape, chunk),
                dtype=dtype,
                fill_value=np.nan if dtype.kind == "f" else 0,
                compressors=(ZstdCodec(level=3), Crc32cCodec()),
                dimension_names=(*variable.dims, "trial"),
            )
            _place(half, array, 0).parent.mkdir(parents=True)  # here, where it is synced
        _sync([*half.rglob("*"), half])
        half.rename(folder / RESULTS)
        _sync([folder])
    except OSError as error:
        shutil.rmtree(half, ignore_errors=True)
        if (folder / RESULTS).exists():
            raise StudyError(f"{folder}: another run began there at the same time") from error
        raise StudyError(f"{folder}: cannot be made: {error.strerror or error}") from error
    return open_chunks(folder)


def open_chunks(folder: pathlib.Path) -> Chunks:
    """Open the folder of a study.

    Raises:
        StudyError: there is none, or it is of another version or broken.

    Example:
        >>> open_chunks(pathlib.Path("nowhere"))
        Traceback (most recent call last):
        jaxtrack.studies.study_file.StudyError: nowhere: there is no study here
    """
    if not (folder / RESULTS).exists():
        raise StudyError(f"{folder}: there is no study here")
    try:
        group = zarr.open_group(folder / RESULTS, mode="r+", zarr_format=3)
        attributes = group.attrs
        if "format" not in attributes:
            raise StudyError(f"{folder}: holds results, but not those of a study's file")
        if attributes["format"] != FORMAT:
            kind = f"has format {attributes['format']}, this version of jaxtrack reads {FORMAT}"
            raise StudyError(f"{folder}: the store {kind}")
        # What equals the fill value is written too, so that a file that is lost is missed.
        with zarr.config.set({"array.write_empty_chunks": True}):
            arrays = dict(group.arrays())
        some = next(iter(arrays.values()))
        return Chunks(folder, some.shape[-1], some.chunks[-1], attributes, arrays)
    except StudyError:
        raise
    except Exception as error:  # whatever zarr makes of a broken file
        reason = " ".join(str(error).split())
        raise StudyError(f"{folder / RESULTS}: cannot be read: {reason}") from error


def committed(store: Chunks) -> set[int]:
    """Return the numbers of the chunks that have a commit record, damaged ones included."""
    files = (store.folder / COMMITS).glob("*.json")
    return {int(file.stem) for file in files if re.fullmatch(r"\d{8,}", file.stem)}


def commit_times(store: Chunks) -> dict[int, float]:
    """Return when the chunks were stored, in seconds since 1970, as far as files can tell."""
    return {number: _record_file(store, number).stat().st_mtime for number in committed(store)}


def read(store: Chunks, number: int) -> dict[str, np.ndarray] | None:
    """Return a chunk's values, `[grid …, trials of the chunk]`; None if it is not there or damaged.

    Raises:
        OSError: the disk does not let it be read.
    """
    record = _record_file(store, number)
    if not record.exists():
        return None
    first, end = store.span(number)
    try:
        checksums = json.loads(record.read_text(encoding="utf-8"))["checksums"]
        values = {name: np.asarray(array[..., first:end]) for name, array in store.arrays.items()}
    except FileNotFoundError:  # another process writes it again
        return None
    except OSError:
        raise
    except Exception:  # a truncated file: JSON's, Crc32c's or zstd's own complaint
        return None
    return values if checksums == _checksums(values) else None


def write(store: Chunks, number: int, values: Mapping[str, np.ndarray]) -> None:
    """Write a chunk and then its commit record; whatever was there of it is replaced.

    Raises:
        StudyError: the disk is full, or does not let it be written; other chunks stay.
    """
    first, end = store.span(number)
    record = _record_file(store, number)
    text = json.dumps({"trials": [first, end], "checksums": _checksums(values)}, indent=1)
    half = record.with_name(f"{_HALF}{record.name}")
    try:
        # What is not whole must not count: the record goes first and comes last.
        record.unlink(missing_ok=True)
        _sync([record.parent])
        for name, array in store.arrays.items():
            file = _file(store, name, number)
            file.unlink(missing_ok=True)
            array[..., first:end] = values[name]
            _sync([file, file.parent])
        half.write_text(text + "\n", encoding="utf-8")
        _sync([half])
        half.replace(record)
        _sync([record.parent])
    except OSError as error:
        with contextlib.suppress(OSError):
            remove(store, number)
        what = f"{store.folder}: trials {first} to {end - 1} could not be written"
        reason = f"{error.strerror or error}; what was stored before is whole"
        raise StudyError(f"{what}: {reason}") from error


def remove(store: Chunks, number: int) -> None:
    """Remove a chunk, and what a broken write of it left behind.

    Raises:
        OSError: the folder cannot be written.
    """
    record = _record_file(store, number)
    record.unlink(missing_ok=True)
    _sync([record.parent])
    record.with_name(f"{_HALF}{record.name}").unlink(missing_ok=True)
    for name in store.arrays:
        file = _file(store, name, number)
        for part in (file, *file.parent.glob(f"{file.name}.*")):  # zarr's, half written
            part.unlink(missing_ok=True)


def clean(store: Chunks) -> None:
    """Remove what broken writes left behind, while no process writes.

    Raises:
        OSError: the folder cannot be written.
    """
    numbers = committed(store)
    results, commits = store.folder / RESULTS, store.folder / COMMITS
    whole = {_file(store, name, number) for name in store.arrays for number in numbers}
    whole |= {_record_file(store, number) for number in numbers}
    for half in store.folder.glob(f"{_HALF}{RESULTS}*"):
        shutil.rmtree(half, ignore_errors=True)
    commits.mkdir(exist_ok=True)
    found = {*commits.iterdir(), *(f for name in store.arrays for f in _files(results / name))}
    for file in found - whole:
        file.unlink()
    _sync([commits])


def check_writable(store: Chunks) -> None:
    """Find out before hours of computing, not after, that nothing can be written.

    Raises:
        StudyError: nothing can.
    """
    try:
        with tempfile.NamedTemporaryFile(prefix=_HALF, dir=store.folder / COMMITS):
            pass
    except OSError as error:
        raise StudyError(
            f"{store.folder}: cannot be written: {error.strerror or error}; what is stored is whole"
        ) from error


def dataset(store: Chunks, trials: int) -> xr.Dataset:
    """Return the first trials of all variables, labelled, read from disk when they are used."""
    results = store.folder / RESULTS
    found = xr.open_zarr(results, consolidated=False, chunks=None, mask_and_scale=False)
    labels = {name: np.array(values) for name, values in store.attributes["labels"].items()}
    return found.isel(trial=slice(trials)).assign_coords(labels)


def _record_file(store: Chunks, number: int) -> pathlib.Path:
    return store.folder / COMMITS / f"{number:08d}.json"


def _file(store: Chunks, name: str, number: int) -> pathlib.Path:
    return _place(store.folder / RESULTS, store.arrays[name], number)


def _place(results: pathlib.Path, array: zarr.Array[Any], number: int) -> pathlib.Path:
    """Return the file of an array's chunk."""
    place = (*(0 for _ in array.shape[:-1]), number)
    return results / array.basename / array.metadata.encode_chunk_key(place)


def _files(folder: pathlib.Path) -> Iterable[pathlib.Path]:
    """Return the files of an array's chunks."""
    return (path for path in (folder / "c").rglob("*") if path.is_file())


def _checksums(values: Mapping[str, np.ndarray]) -> dict[str, str]:
    digest = lambda x: hashlib.sha256(np.ascontiguousarray(x).tobytes()).hexdigest()
    return {name: digest(array) for name, array in sorted(values.items())}


def _sync(paths: Iterable[pathlib.Path]) -> None:
    """Wait until files, and folders with the names in them, have reached the disk."""
    for path in paths:
        if path.is_dir() and os.name != "posix":  # cannot be opened elsewhere
            continue
        handle = os.open(path, os.O_RDONLY if path.is_dir() else os.O_RDWR)
        try:
            os.fsync(handle)
        finally:
            os.close(handle)
