"""Runs a study: chunks of trials through `monte_carlo`, onto the disk, until there are enough.

Trial t has the key fold_in(key(seed), t) in every cell and with every method, so methods are
compared on the same draws. A method is one program; its cells differ in traced values, but for
those of static fields. A chunk that is stored is read, not computed, so a study that was stopped
goes on where it was and ends in the same bytes.

Several processes share a study once `jax.distributed.initialize` has brought them together. Whoever
is free takes the next chunk. Each follows on the disk which chunks are there from the first on, and
so finds the same end.
"""

import math
import pathlib
import time
from collections.abc import Callable
from typing import NamedTuple

import numpy as np

from jaxtrack.studies import chunks, made, summary
from jaxtrack.studies.design import Design, axes_of, design_of
from jaxtrack.studies.hold import held
from jaxtrack.studies.processes import END, LOOK_AGAIN_S, OPEN, Processes, together
from jaxtrack.studies.study_file import StudyError
from jaxtrack.studies.trials import Program, compute, programs_of, variables_of

_SEEN_AFTER_S = 120.0  # so late may a folder be seen that another machine has made


class Progress(NamedTuple):
    """How far a study is."""

    done: float  # trials of every cell
    total: float  # that there will be; with `until`, as the errors so far let expect
    rate: float  # trials a second, this session
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
    on_progress: Callable[[Progress], None] = lambda _: None,
    stopped: Callable[[], bool] = lambda: False,
) -> Outcome:
    """Run a study, or go on with it, and return where it then stands.

    Args:
        design: of the study.
        folder: for its results; one that holds them already must be of the same study.
        on_progress: called now and then.
        stopped: asked after each chunk whether that was the last for now.

    Raises:
        StudyError: a function does not fit, the folder is of another study, or the disk fails.

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
    with together() as team:
        programs = programs_of(design)
        variables = variables_of(design, programs)
        store = _open(team, design, folder, variables)
        chunks.check_writable(store)
        if team.index == 0:
            with held(folder, alone=True):
                chunks.clean(store)
        with held(folder, alone=False):
            team.tell(OPEN)
            computed = _computed(design, programs, variables, store, on_progress)
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
    return _design_in(chunks.open_chunks(folder), functions=True)


def status_of(folder: pathlib.Path) -> Outcome:
    """Return where the study in a folder stands; computes and writes nothing, needs no function.

    Raises:
        StudyError: there is none, or it cannot be read.
    """
    store = chunks.open_chunks(folder)
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
    text, folder = store.attributes["text"], pathlib.Path(store.attributes["folder"])
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
    computed: Callable[[int, summary.Moments | None], dict[str, np.ndarray]],
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
                    values = computed(mine, found)
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
    for number in chunks.committed(store):
        if number >= _following(design, found):
            chunks.remove(store, number)
    return found


def _open(
    team: Processes,
    design: Design,
    folder: pathlib.Path,
    variables: dict[str, chunks.Variable],
) -> chunks.Chunks:
    """Return the folder's store, a new one if there is none; refuse another study's."""
    if team.index:
        team.wait_for(lambda: team.is_ending() or bool(team.told(OPEN)))
        until = time.monotonic() + _SEEN_AFTER_S
        team.wait_for(lambda: (folder / chunks.RESULTS).exists() or time.monotonic() > until)
        if not (folder / chunks.RESULTS).exists():
            raise StudyError(f"{folder}: process {team.index} does not see what process 0 has made")
    facts = {"study": design.config, "made_with": made.decisive(design)}
    if not (folder / chunks.RESULTS).exists():
        attributes = {
            **facts,
            "labels": {
                k: v for method in design.methods for k, v in axes_of(design, method).items()
            },
            "text": design.text,
            "folder": str(design.folder),
            "about": made.about(design),
        }
        return chunks.create(
            folder, variables, trials=design.trials, chunk=design.chunk, attributes=attributes
        )
    store = chunks.open_chunks(folder)
    differing = made.differences({key: store.attributes.get(key) for key in facts}, facts)
    if differing:
        same = store.attributes.get("study") == design.config
        whose = (
            "this study's trials, made with other versions or files"
            if same
            else "another study's trials"
        )
        raise StudyError(f"{folder}: holds {whose}; what differs: {'; '.join(differing)}")
    missing = sorted(variables.keys() - store.arrays.keys())
    if missing:
        raise StudyError(
            f"{folder}: {', '.join(missing)} is missing there: begin in another folder"
        )
    if team.index == 0 and store.attributes["text"] != design.text:
        store.attributes["text"] = design.text  # its words and comparisons decide no result
    return store


def _computed(
    design: Design,
    programs: list[Program],
    variables: dict[str, chunks.Variable],
    store: chunks.Chunks,
    on_progress: Callable[[Progress], None],
) -> Callable[[int, summary.Moments | None], dict[str, np.ndarray]]:
    """Return what computes a chunk's values and reports it: `(number, found before) -> values`."""
    clock: float | None = None  # the first chunk, which compiles, is not timed
    timed = 0  # trials computed since

    def computed(number: int, found: summary.Moments | None) -> dict[str, np.ndarray]:
        nonlocal clock, timed
        first, end = store.span(number)
        report = _reporter(design, first, end, found, (timed, clock), on_progress)
        values = compute(design, programs, variables, first, end, report)
        timed += 0 if clock is None else end - first
        clock = clock or time.perf_counter()
        return values

    return computed


def _reporter(
    design: Design,
    first: int,
    end: int,
    found: summary.Moments | None,
    before: tuple[int, float | None],
    on_progress: Callable[[Progress], None],
) -> Callable[[float], None]:
    """Return what a chunk calls with the share of it that is done."""
    last, total = None, float(design.trials)
    timed, since = before[0], before[1] or time.perf_counter()
    if found is not None:
        metric = design.until.metric if design.until else design.metrics[0].name
        last = summary.widest(design, found, metric)
        if design.until is not None and math.isfinite(last[2]):
            # An error falls with the square root of the trials.
            total = min(total, found.trials * (last[2] / design.until.se) ** 2)

    def report(share: float) -> None:
        done = first + share * (end - first)
        rate = (timed + done - first) / (time.perf_counter() - since)
        on_progress(Progress(done, max(total, done), rate, last))

    return report
