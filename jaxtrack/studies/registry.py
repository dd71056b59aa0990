"""What a study is: a paper's experiments, run again, with marks that were fixed beforehand."""

import functools
import pathlib
from collections.abc import Callable
from typing import NamedTuple

import jax
from rich.console import Console

from jaxtrack.types import Key


class Context(NamedTuple):
    """What a study is given to run with."""

    out: pathlib.Path  # folder for its files; exists
    trials: int  # a cell
    seed: int
    console: Console  # where its tables go
    progress: Callable[[str, int, int], None]  # (what, done, total)

    def key(self, *numbers: int) -> Key:
        """Return the random key of a stream, told from others by its numbers.

        Example:
            >>> from rich.console import Console
            >>> context = Context(pathlib.Path(), 1, 0, Console(), lambda *_: None)
            >>> bool((context.key(1) == context.key(2)).all())
            False
        """
        return functools.reduce(jax.random.fold_in, numbers, jax.random.key(self.seed))


class Study(NamedTuple):
    """One entry of the registry."""

    name: str  # what the command line calls it
    title: str  # one line
    source: str  # the paper
    trials_short: int  # a cell, by default
    trials_full: int  # a cell, in the stated numbers
    seconds_short: float  # measured on two cores, compilation included
    seconds_full: float
    run: Callable[[Context], None]  # computes, prints its tables, writes its files
