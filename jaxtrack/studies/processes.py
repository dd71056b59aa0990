"""The processes of one run, on one machine or on many, that `jax.distributed` brought together.

They meet in its coordination service alone, a table of keys and texts that process 0 keeps. Trials
pass over the disk that all of them see, and nothing between devices.
"""

import contextlib
import itertools
import time
from collections.abc import Callable, Iterator
from typing import Any, NamedTuple

from jax._src import distributed  # the table has no public name; libraries of checkpoints use this

from jaxtrack.studies.study_file import StudyError

# What processes tell each other.
OPEN = "open"  # process 0: the folder is there and clean
END = "end"  # let all come to an end; with a reason if it is an error
LEFT = "left"  # nothing more is written by this one
LOOK_AGAIN_S = 0.1


class Processes(NamedTuple):
    """A run's processes, as one of them sees them."""

    index: int
    count: int
    client: Any  # of the table; None: a process on its own
    run: str  # how this run's keys begin

    def tickets(self) -> Iterator[int]:
        """Yield 0, 1, …, each number to one process only: whoever is free takes the next."""
        if self.client is None:
            yield from itertools.count()
            return
        while True:
            yield self.client.key_value_increment(f"{self.run}/ticket", 1) - 1

    def tell(self, what: str, text: str = "") -> None:
        """Tell all processes something."""
        if self.client is not None:
            key = f"{self.run}/{what}/{self.index}"
            self.client.key_value_set(key, text, allow_overwrite=True)

    def told(self, what: str) -> dict[int, str]:
        """Return which processes, this one included, have told something."""
        if self.client is None:
            return {}
        found = self.client.key_value_dir_get(f"{self.run}/{what}/")
        return {int(key.rpartition("/")[2]): text for key, text in found}

    def is_ending(self) -> bool:
        """Return whether some process wishes all to come to an end.

        Raises:
            StudyError: another one met an error.
        """
        ends = self.told(END)
        for index, reason in sorted(ends.items()):
            if reason and index != self.index:
                raise StudyError(f"process {index} ended: {reason}")
        return bool(ends)

    def wait_for(self, what: Callable[[], bool]) -> None:
        """Wait until something is so; JAX ends this process where another one has died."""
        while not what():
            time.sleep(LOOK_AGAIN_S)

    def leave(self) -> None:
        """Wait until no process of the run writes anything more.

        They go together: JAX gives those that stay five minutes, and a chunk may take longer.
        """
        if self.client is not None:
            self.tell(LEFT)
            self.wait_for(lambda: len(self.told(LEFT)) == self.count)


@contextlib.contextmanager
def together() -> Iterator[Processes]:
    """Be one of the processes of a new run; all of them do so, in the same order of runs.

    An error of one is told to all the others, and nobody goes before all have heard of it.

    Example:
        >>> with together() as team:
        ...     team.count, list(itertools.islice(team.tickets(), 3)), team.is_ending()
        (1, [0, 1, 2], False)
    """
    state = distributed.global_state
    if state.client is None:
        yield Processes(0, 1, None, "")
        return
    index = state.process_id
    run = state.client.key_value_increment(f"jaxtrack/runs_of/{index}", 1)
    team = Processes(index, state.num_processes, state.client, f"jaxtrack/{run}")
    try:
        yield team
    except BaseException as error:
        if not team.told(END):
            team.tell(END, " ".join(str(error).split()) or "interrupted")
        if isinstance(error, Exception):
            team.leave()
        team.tell(LEFT)
        raise
