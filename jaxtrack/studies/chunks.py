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
import shutil
import tempfile
from collections.abc import Iterable, Mapping
from typing import Any, NamedTuple

import numpy as np
import xarray as xr
import zarr

from jaxtrack.studies.store import RESULTS
from jaxtrack.studies.study_file import StudyError

COMMITS = "commits"
HALF = "half_"
"""How names begin of what is not whole yet."""


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
    attributes: dict[str, Any]
    variables: dict[str, Variable]
    arrays: dict[str, zarr.Array[Any]]  # those that are there and as they should be

    @property
    def count(self) -> int:
        """How many chunks there are to be."""
        return -(-self.trials // self.chunk)

    def span(self, number: int) -> tuple[int, int]:
        """Return the first trial of a chunk, and the first that is not of it."""
        return number * self.chunk, min((number + 1) * self.chunk, self.trials)

    def attribute(self, name: str) -> Any:
        """Return an attribute.

        Raises:
            StudyError: it is missing.
        """
        if name not in self.attributes:
            raise StudyError(f"{self.folder / RESULTS}: its attribute {name} is missing")
        return self.attributes[name]

    def record(self, number: int) -> pathlib.Path:
        """Return the file of a chunk's commit record."""
        return self.folder / COMMITS / f"{number:08d}.json"

    def file(self, name: str, number: int) -> pathlib.Path:
        """Return the file of a variable's chunk."""
        return self.folder / RESULTS / name / place(self.variables[name], number)


def place(variable: Variable, number: int) -> str:
    """Return where in its array's folder a chunk lies: all of the grid, some of the trials.

    Example:
        >>> place(Variable(("sigma_m",), (3,), "float32"), 7)
        'c/0/7'
    """
    return "/".join(["c", *("0" for _ in variable.shape), str(number)])


def committed(store: Chunks) -> set[int]:
    """Return the numbers of the chunks that have a commit record, damaged ones included."""
    files = (store.folder / COMMITS).glob("*.json")
    return {int(file.stem) for file in files if re.fullmatch(r"\d{8,}", file.stem)}


def commit_times(store: Chunks) -> dict[int, float]:
    """Return when the chunks were stored, in seconds since 1970, as far as files can tell."""
    found = {}
    for number in committed(store):
        with contextlib.suppress(FileNotFoundError):  # a run beside this one removes it
            found[number] = store.record(number).stat().st_mtime
    return found


def read(store: Chunks, number: int) -> dict[str, np.ndarray] | None:
    """Return a chunk's values, `[grid …, trials of the chunk]`; None if it is not there or damaged.

    Raises:
        OSError: the disk does not let it be read.
    """
    record = store.record(number)
    if not record.exists():
        return None
    first, end = store.span(number)
    try:
        kept = json.loads(record.read_text(encoding="utf-8"))["checksums"]
        values = {name: np.asarray(array[..., first:end]) for name, array in store.arrays.items()}
    except FileNotFoundError:  # another process writes it again
        return None
    except (OSError, MemoryError):
        raise
    except Exception:  # a truncated file: JSON's, Crc32c's or zstd's own complaint
        return None
    return values if kept == _checksums(values) else None


def write(store: Chunks, number: int, values: Mapping[str, np.ndarray]) -> None:
    """Write a chunk and then its commit record; whatever was there of it is replaced.

    Raises:
        StudyError: the disk is full, or does not let it be written; other chunks stay.
    """
    first, end = store.span(number)
    record = store.record(number)
    text = json.dumps({"trials": [first, end], "checksums": _checksums(values)}, indent=1)
    half = record.with_name(f"{HALF}{record.name}")
    try:
        # What is not whole must not count: the record goes first and comes last.
        record.unlink(missing_ok=True)
        sync([record.parent])
        for name, array in store.arrays.items():
            file = store.file(name, number)
            file.unlink(missing_ok=True)
            array[..., first:end] = values[name]
            sync([file, file.parent])
        half.write_text(text + "\n", encoding="utf-8")
        sync([half])
        half.replace(record)
        sync([record.parent])
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
    record = store.record(number)
    record.unlink(missing_ok=True)
    sync([record.parent])
    record.with_name(f"{HALF}{record.name}").unlink(missing_ok=True)
    for name in store.variables:
        file = store.file(name, number)
        for part in (file, *file.parent.glob(f"{file.name}.*")):  # zarr's, half written
            part.unlink(missing_ok=True)


def clean(store: Chunks) -> None:
    """Remove what broken writes left behind, while no process writes.

    Raises:
        OSError: the folder cannot be written.
    """
    numbers = committed(store)
    results, commits = store.folder / RESULTS, store.folder / COMMITS
    whole = {store.file(name, number) for name in store.variables for number in numbers}
    whole |= {store.record(number) for number in numbers}
    for half in store.folder.glob(f"{HALF}{RESULTS}*"):
        shutil.rmtree(half, ignore_errors=True)
    commits.mkdir(exist_ok=True)
    found = {*commits.iterdir(), *(f for name in store.variables for f in _files(results / name))}
    for file in found - whole:
        file.unlink()
    sync([commits])


def check_writable(store: Chunks) -> None:
    """Find out before hours of computing, not after, that nothing can be written.

    Raises:
        StudyError: nothing can.
    """
    try:
        with tempfile.NamedTemporaryFile(prefix=HALF, dir=store.folder / COMMITS):
            pass
    except OSError as error:
        raise StudyError(
            f"{store.folder}: cannot be written: {error.strerror or error}; what is stored is whole"
        ) from error


def dataset(store: Chunks, trials: int) -> xr.Dataset:
    """Return the first trials of all variables, labelled, read from disk when they are used."""
    results = store.folder / RESULTS
    found = xr.open_zarr(results, consolidated=False, chunks=None, mask_and_scale=False)
    labels = {name: np.array(values) for name, values in store.attribute("labels").items()}
    return found.isel(trial=slice(trials)).assign_coords(labels)


def _files(folder: pathlib.Path) -> Iterable[pathlib.Path]:
    """Return the files of an array's chunks."""
    return (path for path in (folder / "c").rglob("*") if path.is_file())


def _checksums(values: Mapping[str, np.ndarray]) -> dict[str, str]:
    digest = lambda x: hashlib.sha256(np.ascontiguousarray(x).tobytes()).hexdigest()
    return {name: digest(array) for name, array in sorted(values.items())}


def sync(paths: Iterable[pathlib.Path]) -> None:
    """Wait until files, and folders with the names in them, have reached the disk."""
    for path in paths:
        if path.is_dir() and os.name != "posix":  # cannot be opened elsewhere
            continue
        handle = os.open(path, os.O_RDONLY if path.is_dir() else os.O_RDWR)
        try:
            os.fsync(handle)
        finally:
            os.close(handle)
