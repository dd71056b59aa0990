"""One run at a time holds a study's folder: two would remove each other's half written chunks."""

import contextlib
import pathlib
from collections.abc import Iterator

from jaxtrack.studies.store import RESULTS
from jaxtrack.studies.study_file import StudyError

try:
    import fcntl
except ImportError:  # not on every system
    fcntl = None


@contextlib.contextmanager
def held(folder: pathlib.Path, *, alone: bool) -> Iterator[None]:
    """Hold the folder of a study; the system lets go of it for a process that dies.

    Args:
        folder: of the study.
        alone: no other process may hold it; else those of the same run may.

    Raises:
        StudyError: another run holds it.
    """
    with open(folder / RESULTS / "zarr.json", "r+b") as file:
        if fcntl is not None:
            kind = fcntl.LOCK_EX if alone else fcntl.LOCK_SH
            try:
                fcntl.flock(file, kind | fcntl.LOCK_NB)
            except BlockingIOError as error:
                raise StudyError(f"{folder}: another run is at work there") from error
            except OSError:  # a file system without locks
                pass
        yield
