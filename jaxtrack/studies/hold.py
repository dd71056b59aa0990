"""One run at a time holds a study's folder: two would remove each other's half written chunks."""

import contextlib
import functools
import math
import pathlib
import time
from collections.abc import Callable, Iterator, Mapping
from typing import IO, Any

from jaxtrack.studies import chunk_store, chunks, made
from jaxtrack.studies.design import Design, axes_of
from jaxtrack.studies.processes import OPEN, Processes
from jaxtrack.studies.study_file import StudyError

try:
    import fcntl
except ImportError:  # not on every system
    fcntl = None

LOCK = "lock"
_SEEN_AFTER_S = 120.0  # so late may a folder be seen that another machine has made


@contextlib.contextmanager
def held(folder: pathlib.Path, *, alone: bool) -> Iterator[Callable[[], None]]:
    """Hold the folder of a study; the system lets go of it for a process that dies.

    The lock lies in a file of its own, which is made before anything else is. Who may not even
    make it holds nothing: nothing can be written there.

    Args:
        folder: of the study; made if it is not there.
        alone: no other process may hold it; else those of the same run may.

    Yields:
        What lets the other processes of the same run hold it too.

    Raises:
        StudyError: another run holds it, or it cannot be made.

    Example:
        >>> import tempfile
        >>> with tempfile.TemporaryDirectory() as name:
        ...     with held(pathlib.Path(name), alone=True) as share:
        ...         share()
        ...         with held(pathlib.Path(name), alone=False):
        ...             print("two hold it")
        two hold it
    """
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise StudyError(f"{folder}: cannot be made: {error.strerror or error}") from error
    with _lock_file(folder / LOCK) as file:
        _lock(file, folder, alone)
        yield functools.partial(_lock, file, folder, False)


@contextlib.contextmanager
def opened(
    team: Processes,
    design: Design,
    folder: pathlib.Path,
    variables: dict[str, chunks.Variable],
) -> Iterator[chunks.Chunks]:
    """Hold a study's folder and open its store, which the first process makes and cleans alone.

    Args:
        team: the processes of the run.
        design: of the study.
        folder: for its results.
        variables: what it stores.

    Yields:
        The store.

    Raises:
        StudyError: it is another study's, another run holds it, or it cannot be written.
    """
    if team.index:
        team.wait_for(lambda: team.is_ending() or bool(team.told(OPEN)))
        until = time.monotonic() + _SEEN_AFTER_S
        team.wait_for(lambda: (folder / chunks.RESULTS).exists() or time.monotonic() > until)
        if not (folder / chunks.RESULTS).exists():
            raise StudyError(f"{folder}: process {team.index} does not see what process 0 has made")
    with held(folder, alone=team.index == 0) as share:
        store = _store(design, folder, variables, may_change=team.index == 0)
        if team.index == 0:
            with contextlib.suppress(OSError):  # a study that is complete may lie where none writes
                chunks.clean(store)
            if team.count > 1:
                share()
                team.tell(OPEN)
        yield store


def _store(
    design: Design,
    folder: pathlib.Path,
    variables: dict[str, chunks.Variable],
    *,
    may_change: bool,
) -> chunks.Chunks:
    """Return the folder's store, a new one if there is none; refuse another study's."""
    facts = {"study": design.config, "made_with": made.decisive(design)}
    axes = (axes_of(design, method) for method in design.methods)
    attributes = {
        **facts,
        "labels": {name: values for own in axes for name, values in own.items()},
        "text": design.file.text,
        "folder": str(design.folder),
        "about": made.about(design),
    }
    if not (folder / chunks.RESULTS).exists():
        trials, chunk = design.trials, design.chunk
        return chunk_store.create(
            folder, variables, trials=trials, chunk=chunk, attributes=attributes
        )
    store = chunk_store.open_chunks(folder)
    # Words decide nothing, nor where they stand.
    words = {key: attributes[key] for key in ("text", "folder")}
    kept = {**attributes, **store.attributes, **words}
    study: Any = store.attributes.get("study")
    if may_change and study != design.config and _ends_later(design.config, study):
        kept["study"] = attributes["study"]
        study = {k: v for k, v in study.items() if k not in ("trials", "until")}
        study |= {k: v for k, v in design.config.items() if k in ("trials", "until")}
    there = {"study": study, "made_with": store.attributes.get("made_with")}
    differing = made.differences(there, facts)
    differing += made.differences(store.variables, variables, "variables")
    if differing:
        whose = (
            "this study's trials, made with other versions or files"
            if study == design.config
            else "another study's trials"
        )
        raise StudyError(f"{folder}: holds {whose}; what differs: {'; '.join(differing)}")
    missing = store.arrays.keys() != variables.keys()
    if not may_change or (kept == store.attributes and not missing):
        return store
    try:
        return chunk_store.amend(store, trials=design.trials, attributes=kept)
    except StudyError:
        if missing or kept != {**store.attributes, **words}:
            raise
        return store  # a complete study may lie where none writes


def _ends_later(new: Mapping[str, Any], old: Any) -> bool:
    """Return whether a study ends no earlier than another one, whose trials all count for it."""
    if not isinstance(old, Mapping):
        return False
    rule, before = new.get("until"), old.get("until")
    later = rule is None or (
        before is not None and rule["metric"] == before["metric"] and rule["se"] <= before["se"]
    )
    return later and new["trials"] >= old.get("trials", math.inf)


def _lock_file(file: pathlib.Path) -> contextlib.AbstractContextManager[IO[bytes] | None]:
    for mode in ("a+b", "rb"):
        with contextlib.suppress(OSError):
            return open(file, mode)
    return contextlib.nullcontext()


def _lock(file: IO[bytes] | None, folder: pathlib.Path, alone: bool) -> None:
    """Lock, or change the kind of lock: should another run come between, it has the folder."""
    if file is None or fcntl is None:
        return
    try:
        fcntl.flock(file, (fcntl.LOCK_EX if alone else fcntl.LOCK_SH) | fcntl.LOCK_NB)
    except BlockingIOError as error:
        raise StudyError(f"{folder}: another run is at work there") from error
    except OSError:  # a file system without locks
        pass
