"""Commands on studies from files: run, go on, look."""

import contextlib
import math
import os
import pathlib
import shutil
import signal
import sys
import time
from collections.abc import Callable, Iterator
from typing import TYPE_CHECKING, Any, Literal

from jaxtrack.cli.screen import console_of_tables, fail, line, use_all_cores

if TYPE_CHECKING:
    from jaxtrack.studies.design import Design
    from jaxtrack.studies.run import Outcome, Progress

_SAY_AFTER_S = 30.0  # without a terminal, progress is a line that often


def study(
    action: Literal["run", "resume", "status", "report"],
    target: pathlib.Path,
    /,
    *,
    out: pathlib.Path | None = None,
    coordinator_address: str | None = None,
    num_processes: int | None = None,
    process_id: int | None = None,
) -> int:
    """Run a study that a TOML file describes, go on with it, see how far it is, or report it.

    The options from --coordinator-address on are for several processes, on one machine or many,
    that share a study's folder; under SLURM they are found out.

    Args:
        action: run a file (and go on, if its folder is there); resume or show a folder, or write
            its report.html, also before it is complete.
        target: of run: a TOML file, or the name of one that comes with jaxtrack; else a folder.
        out: of run: the folder for the results; results/NAME if it is not given. Of report: the
            folder for report.html; the study's if it is not given.
        coordinator_address: HOST:PORT, a free port of the machine of process 0.
        num_processes: how many there are.
        process_id: which of them this is, from 0 on.
    """
    joint = (coordinator_address, num_processes, process_id)
    if out is not None and action in ("status", "resume"):
        return fail(f"--out: is for run and report; {action} takes the folder itself")
    if action in ("run", "resume"):
        # From the first line on: JAX drops a KeyboardInterrupt that comes as it collects garbage.
        with _interrupts() as stopped:
            return _run(action, target, out, joint, stopped)
    if any(value is not None for value in joint):
        return fail("--coordinator-address, --num-processes, --process-id: are for run and resume")
    from jaxtrack.studies.report.study import write_report
    from jaxtrack.studies.run import status_of
    from jaxtrack.studies.study_file import StudyError

    try:
        if action == "status":
            _show(status_of(target), target)
        else:
            print(write_report(status_of(target), target, out))
    except (StudyError, OSError) as error:
        return fail(line(error))
    return 0


def _run(
    action: str,
    target: pathlib.Path,
    out: pathlib.Path | None,
    joint: tuple[str | None, int | None, int | None],
    stopped: Callable[[], bool],
) -> int:
    """Run a study to its end, or as far as the user lets it."""
    use_all_cores()
    from jaxtrack.studies.processes import together
    from jaxtrack.studies.run import run_study
    from jaxtrack.studies.study_file import StudyError

    try:
        first = _join(*joint)
        with together() as team:
            design, folder = _study_of(action, target, out)
            with _progress_line(shown=first) as report:
                outcome = run_study(design, folder, team=team, on_progress=report, stopped=stopped)
    except (StudyError, OSError) as error:
        return fail(line(error))
    if first:
        _show(outcome, folder)
    return 0 if outcome.complete else 130


def _join(
    coordinator_address: str | None, num_processes: int | None, process_id: int | None
) -> bool:
    """Join the other processes, if there are any, and return whether this is the first."""
    import jax

    from jaxtrack.studies.study_file import StudyError

    options = {
        "--coordinator-address": coordinator_address,
        "--num-processes": num_processes,
        "--process-id": process_id,
    }
    missing = [name for name, value in options.items() if value is None]
    if len(missing) == len(options) and int(os.environ.get("SLURM_STEP_NUM_TASKS", "1")) == 1:
        return True
    if 0 < len(missing) < len(options):
        raise StudyError(f"{missing[0]}: is missing; {', '.join(options)} belong together")
    if coordinator_address is not None and ":" not in coordinator_address:
        raise StudyError(f"--coordinator-address: got {coordinator_address}, want HOST:PORT")
    # It would keep the process from ending when it is told to.
    jax.config.update("jax_enable_preemption_service", False)
    # Python does not hear Ctrl-C while they wait for each other; there is nothing yet to lose.
    before = signal.signal(signal.SIGINT, signal.SIG_DFL)
    try:
        jax.distributed.initialize(coordinator_address, num_processes, process_id)
        jax.local_devices()  # they wait here too
    except (ValueError, RuntimeError) as error:
        raise StudyError(f"processes cannot be joined: {error}") from error
    finally:
        signal.signal(signal.SIGINT, before)
    return jax.process_index() == 0


def _study_of(
    action: str, target: pathlib.Path, out: pathlib.Path | None
) -> tuple["Design", pathlib.Path]:
    """Return a study, and the folder for its results."""
    from jaxtrack.studies.design import read_design
    from jaxtrack.studies.functions import shipped_study
    from jaxtrack.studies.run import open_study

    if action == "resume":
        return open_study(target), target
    is_name = target.name == str(target) and not target.suffix and not target.is_file()
    design = read_design(shipped_study(target.name) if is_name else target)
    return design, pathlib.Path("results") / target.stem if out is None else out


@contextlib.contextmanager
def _interrupts() -> Iterator[Callable[[], bool]]:
    """Turn the first Ctrl-C into a wish to stop; the second one stops at once."""
    asked = False

    def ask(number: int, frame: Any) -> None:
        nonlocal asked
        asked = True
        signal.signal(signal.SIGINT, before)
        print("\nends after this chunk; Ctrl-C again: at once", file=sys.stderr)

    before = signal.signal(signal.SIGINT, ask)
    try:
        yield lambda: asked
    finally:
        signal.signal(signal.SIGINT, before)


@contextlib.contextmanager
def _progress_line(*, shown: bool) -> Iterator[Callable[["Progress"], None]]:
    """Show progress on one line of a terminal; without one, a line from time to time."""
    if not shown:
        yield lambda _: None
        return
    screen = sys.stderr
    drawn = screen.isatty()
    every_s = 0.2 if drawn else _SAY_AFTER_S
    said = time.monotonic() - (every_s if drawn else 0)

    def report(progress: "Progress") -> None:
        nonlocal said
        if time.monotonic() - said < every_s:
            return
        said = time.monotonic()
        if drawn:  # a line that wraps could not be drawn over
            text = progress_text(progress, shutil.get_terminal_size().columns - 1)
            print(f"\r\x1b[K{text}", end="", file=screen, flush=True)
        else:
            print(progress_text(progress), file=screen, flush=True)

    try:
        yield report
    finally:
        if drawn:
            print("\r\x1b[K", end="", file=screen, flush=True)


def progress_text(progress: "Progress", width: int | None = None) -> str:
    """Return share done, trials, rate, time left and the metric that is known least.

    What there is no room for: first the trials, then the end of the metric's name.

    Example:
        >>> from jaxtrack.studies.run import Progress
        >>> progress_text(Progress(250, 1000, 50.0, ("mean.error_m", 1.25, 0.031)))
        '25 %, 250 of 1000 trials, 50 a second, 15 s left, mean.error_m 1.25 ± .031'
        >>> progress_text(Progress(250, 1000, 50.0, ("mean.error_m", 1.25, 0.031)), width=48)
        '25 %, 50 a second, 15 s left, mean.… 1.25 ± .031'
    """
    from jaxtrack.studies.tables import duration, plus_minus

    done, total, rate = progress.done, progress.total, progress.rate
    left = duration(max(total - done, 0) / rate) if rate > 0 else "?"
    share = math.floor(100 * min(done / total, 1))
    parts = [f"{share} %", f"{done:.0f} of {total:.0f} trials", f"{rate:.3g} a second"]
    parts.append(f"{left} left")
    if progress.last is not None:
        name, mean, error = progress.last
        parts.append(f"{name} {plus_minus(mean, error)}")
    text = ", ".join(parts)
    if width is None or len(text) <= width:
        return text
    del parts[1]
    text = ", ".join(parts)
    if progress.last is not None and len(text) > width:
        kept = max(len(name) - (len(text) - width) - 1, 0)
        text = text.replace(f" {name} ", f" {name[:kept]}… ")
    return text[:width]


def _show(outcome: "Outcome", folder: pathlib.Path) -> None:
    """Print how far a study is, its table, and how to go on."""
    from jaxtrack.studies import summary
    from jaxtrack.studies.report.compared import count
    from jaxtrack.studies.report.study import compared, spans, table_of
    from jaxtrack.studies.tables import beneath

    console = console_of_tables()
    design, found = outcome.design, outcome.found
    trials = 0 if found is None else found.trials
    rule = ""
    if design.until is not None:
        rule = f", or until the standard errors of {design.until.metric} are {design.until.se:g}"
    console.print(
        f"{folder}: {trials} of {design.trials} trials{rule}", highlight=False, soft_wrap=True
    )
    if found is not None:
        heads, rows, fields = table_of(list(summary.rows(design, found)))
        whole = not console.is_terminal and "COLUMNS" not in os.environ
        width = None if whole else console.width
        for table in beneath(heads, rows, fields=fields, width=width):
            console.print(table, markup=False, crop=not whole)
    verdicts = count(compared(outcome))
    if verdicts:
        console.print(f"{verdicts}; the report has them all", highlight=False)
    if outcome.damaged:
        words = f"damaged, computed again when resumed: chunk {spans(outcome.damaged)}"
        console.print(words, highlight=False, soft_wrap=True)
    if outcome.complete:
        console.print("complete", highlight=False)
    else:
        console.print(f"to go on: jaxtrack study resume {folder}", highlight=False, soft_wrap=True)
