"""What a study is: a paper's experiments, run again, with marks that were fixed beforehand."""

import pathlib
from collections.abc import Callable
from typing import NamedTuple

from rich.console import Console


class Context(NamedTuple):
    """What a study is given to run with."""

    out: pathlib.Path  # folder for its files; exists
    trials: int  # a cell
    seed: int
    console: Console  # where its tables go
    progress: Callable[[str, int, int], None]  # (what, done, total)


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
