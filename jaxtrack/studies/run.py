"""Runs a study: chunks of trials through `monte_carlo`, onto the disk, until there are enough.

Trial t has the key fold_in(key(seed), t) in every cell and with every method, so methods are
compared on the same draws. A method is one program; its cells differ in traced values, but for
those of static fields. A chunk that is stored is read, not computed, so a study that was stopped
goes on where it was and ends in the same bytes, and so does one that is to have more trials.

Several processes share a study once `jax.distributed.initialize` has brought them together. Whoever
is free takes the next chunk. Each follows on the disk which chunks are there from the first on, and
so finds the same end.
"""

import contextlib
import math
import pathlib
import time
from collections.abc import Callable
from typing import NamedTuple

import numpy as np

from jaxtrack.studies import chunk_store, chunks, summary
from jaxtrack.studies.design import Design, design_of
from jaxtrack.studies.hold import opened
from jaxtrack.studies.processes import END, LEFT, LOOK_AGAIN_S, Processes, together
from jaxtrack.studies.trials import compute, programs_of, variables_of


class Progress(NamedTuple):
    """How far a study is."""

    done: float  # trials of every cell
    total: float  # that there will be; with `until`, as the errors so far let expect
    rate: float  # trials a second, of all processes, this session
    last: tuple[str, float, float] | None  # variable, mean, standard error: the widest


class Outcome(NamedTuple):
    """Where a study stands."""

    design: Design
    store: chunks.Chunks
    found: summary.Moments | None  # of the trials that count: whole chunks from the first on
    complete: bool
    damaged: tuple[int, ...]  # chunks with a record that does not fit


def run_study(
    design: Design,
    folder: pathlib.Path,
    *,
    team: Processes | None = None,
    on_progress: Callable[[Progress], None] = lambda _: None,
    stopped: Callable[[], bool] = lambda: False,
) -> Outcome:
    """Run a study, or go on with it, and return where it then stands.

    Args:
        design: of the study.
        folder: for its results; one that holds them already must be of the same study, which may
            have ended earlier: with fewer trials, or a larger error in `until`.
        team: the run's processes, if the caller has them together already; for one run.
        on_progress: called now and then.
        stopped: asked after each chunk whether that was the last for now.

    Raises:
        StudyError: a function does not fit, the folder is of another study, or the disk fails.
        ValueError: the team has run a study before.

    Example:
        >>> import tempfile
        >>> text = '''
        ... trials = 64
        ... chunk = 32
        ... [scene]
        ... function = "jax.random:normal"
        ... [method.size]
        ... function = "jax.numpy:abs"
        ... [metric.negative]
        ... function = "operator:lt"
        ... '''
        >>> with tempfile.TemporaryDirectory() as folder:
        ...     outcome = run_study(design_of(text, pathlib.Path()), pathlib.Path(folder))
        >>> bool(0.2 < outcome.found.mean["size.negative"] < 0.8)
        True
    """
    if team is not None and team.told(LEFT):
        raise ValueError("team: got one that has run a study, want a new one")
    with contextlib.nullcontext(team) if team else together() as team:
        programs = programs_of(design)
        variables = variables_of(design, programs)
        progress = _Reporter(design, on_progress)

        def computed(first: int, end: int, found: summary.Moments | None) -> dict[str, np.ndarray]:
            progress.begin(first, end, found)
            return compute(design, programs, variables, first, end, progress.report)

        with opened(team, design, folder, variables) as store:
            found = _work(team, design, store, computed, stopped)
            team.leave()
            if team.index == 0:
                found = _finished(design, store, found)
    return _outcome(design, store, found, ())


def open_study(folder: pathlib.Path) -> Design:
    """Return the design of the study in a folder.

    Raises:
        StudyError: there is none, or its functions are gone.
    """
    return _design_in(chunk_store.open_chunks(folder), functions=True)


def status_of(folder: pathlib.Path) -> Outcome:
    """Return where the study in a folder stands; computes and writes nothing, needs no function.

    Raises:
        StudyError: there is none, or it cannot be read.
    """
    store = chunk_store.open_chunks(folder)
    design = _design_in(store, functions=False)
    found: summary.Moments | None = None
    records = sorted(chunks.committed(store))
    damaged = []
    for place, number in enumerate(records):
        values = chunks.read(store, number)
        if values is None:
            damaged.append(number)
        elif place == number and not damaged and not (found and summary.enough(design, found)):
            found = summary.merged(found, summary.moments(design, values))
    return _outcome(design, store, found, tuple(damaged))


def _design_in(store: chunks.Chunks, *, functions: bool) -> Design:
    text, folder = store.attribute("text"), pathlib.Path(store.attribute("folder"))
    return design_of(text, folder, f"{store.folder}'s study", functions=functions)


def _outcome(
    design: Design,
    store: chunks.Chunks,
    found: summary.Moments | None,
    damaged: tuple[int, ...],
) -> Outcome:
    return Outcome(design, store, found, _is_complete(design, found), damaged)


def _is_complete(design: Design, found: summary.Moments | None) -> bool:
    return found is not None and (found.trials == design.trials or summary.enough(design, found))


def _following(design: Design, found: summary.Moments | None) -> int:
    """Return the number of the chunk after those that are found."""
    return 0 if found is None else -(-found.trials // design.chunk)


def _work(
    team: Processes,
    design: Design,
    store: chunks.Chunks,
    computed: Callable[[int, int, summary.Moments | None], dict[str, np.ndarray]],
    stopped: Callable[[], bool],
) -> summary.Moments | None:
    """Compute chunks, and return what is found of all processes' when there is no more to do."""
    found: summary.Moments | None = None
    ahead: dict[int, summary.Moments] = {}  # of chunks before which another one is missing
    tickets = team.tickets()
    while True:
        number = _following(design, found)
        if number not in ahead and (values := chunks.read(store, number)) is not None:
            ahead[number] = summary.moments(design, values)
        if number not in ahead:
            mine = next(ticket for ticket in tickets if ticket >= number)
            if mine < store.count:
                values = chunks.read(store, mine)
                if values is None:
                    chunks.check_writable(store)
                    values = computed(*store.span(mine), found)
                    chunks.write(store, mine, values)
                ahead[mine] = summary.moments(design, values)
            else:  # another process computes what is missing
                time.sleep(LOOK_AGAIN_S)
        if number in ahead:
            found = summary.merged(found, ahead.pop(number))
            if _is_complete(design, found):
                return found
        if stopped():
            team.tell(END)
            return found
        if team.is_ending():
            return found


def _finished(
    design: Design, store: chunks.Chunks, found: summary.Moments | None
) -> summary.Moments | None:
    """Return what is found once nobody writes any more, and remove what is beyond a study's end."""
    while not _is_complete(design, found):
        values = chunks.read(store, _following(design, found))
        if values is None:
            return found
        found = summary.merged(found, summary.moments(design, values))
    with contextlib.suppress(OSError):  # it does not count, wherever it must stay
        for number in chunks.committed(store):
            if number >= _following(design, found):
                chunks.remove(store, number)
    return found


class _Reporter:
    """Tells how far a study is, chunk by chunk."""

    def __init__(self, design: Design, on_progress: Callable[[Progress], None]) -> None:
        self._design, self._on_progress = design, on_progress
        self._begun = 0  # chunks
        self._since = 0, 0.0  # the trial and the time from which on the rate is taken

    def begin(self, first: int, end: int, found: summary.Moments | None) -> None:
        """Begin a chunk, after what is found."""
        design = self._design
        if self._begun < 2:  # the first chunk, which compiles, is not timed
            self._since = first, time.perf_counter()
        self._begun += 1
        self._first, self._end = first, end
        self._last, self._total = None, float(design.trials)
        if found is not None:
            metric = design.until.metric if design.until else design.metrics[0].name
            self._last = summary.widest(design, found, metric)
            if design.until is not None and math.isfinite(self._last[2]):
                # An error falls with the square root of the trials.
                expected = found.trials * (self._last[2] / design.until.se) ** 2
                self._total = min(self._total, expected)

    def report(self, share: float) -> None:
        """Tell that a share of the chunk is done."""
        done = self._first + share * (self._end - self._first)
        # Other processes have computed the chunks between: they are given out in order.
        rate = (done - self._since[0]) / (time.perf_counter() - self._since[1])
        self._on_progress(Progress(done, max(self._total, done), rate, self._last))
