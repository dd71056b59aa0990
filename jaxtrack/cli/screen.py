"""What commands show: progress, tables, figures, and errors in one line."""

import contextlib
import math
import os
import pathlib
import sys
import time
from collections.abc import Callable, Iterator, Sequence
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from rich.console import Console

    from jaxtrack.io import Recording
    from jaxtrack.tracking import MotionElements, TrackInfo, WindowInfo
    from jaxtrack.types import Tracks

_WIDTH = 220  # of lines that go to a file or a pipe
_SAY_AFTER_S = 30.0  # without a terminal, progress is a line that often


def use_all_cores() -> None:
    """Make every core a device of JAX; too late, and left alone, once JAX has been used."""
    import jax

    from jaxtrack.montecarlo.advice import available_cores

    cores = available_cores()
    with contextlib.suppress(RuntimeError):
        jax.config.update("jax_num_cpu_devices", cores)


@contextlib.contextmanager
def progress(console: "Console") -> Iterator[Callable[[str, int, int], None]]:
    """Show a bar for each thing that is counted: `report(what, done, total)`.

    Where no bar can be drawn, a line from time to time says that work goes on.
    """
    from rich.progress import (
        BarColumn,
        Progress,
        TextColumn,
        TimeElapsedColumn,
        TimeRemainingColumn,
    )

    columns = (
        TextColumn("{task.description}"),
        BarColumn(),
        TextColumn("{task.completed}/{task.total}"),
        TimeElapsedColumn(),
        TimeRemainingColumn(),
    )
    tasks: dict[str, Any] = {}
    quiet = not console.is_terminal
    said = time.monotonic()
    with Progress(*columns, console=console, transient=True, disable=quiet) as bars:

        def report(what: str, done: int, total: int) -> None:
            nonlocal said
            if quiet and time.monotonic() - said > _SAY_AFTER_S:
                said = time.monotonic()
                console.print(f"{what}: {done} of {total}", highlight=False)
            if what not in tasks:
                tasks[what] = bars.add_task(what, total=total)
            bars.update(tasks[what], completed=done, total=total)

        yield report


def console_of_tables() -> "Console":
    """Return a console on standard output; where that is no terminal, whole tables fit its width.

    A width that `COLUMNS` states is kept.
    """
    from rich.console import Console

    console = Console()
    if console.is_terminal or "COLUMNS" in os.environ:
        return console
    return Console(width=_WIDTH)


def print_tracks(
    console: "Console",
    recording: "Recording",
    tracks: "Tracks",
    info: "WindowInfo",
    seed: int,
) -> None:
    """Print a table of the tracks that start in a window."""
    import numpy as np
    from rich.table import Table

    if info.trials:
        console.print(
            f"gate {info.gate:.2f} from {info.trials} scenes without targets (seed {seed}), "
            f"clutter {info.clutter_per_m2 * 1e6:.3g} a square kilometre and look",
            highlight=False,
            soft_wrap=True,
        )
    live = np.flatnonzero(np.asarray(tracks.mask))
    if not len(live):
        console.print("no tracks")
        return
    x, y = ("x", "y") if recording.axes == "x_y" else ("north", "east")
    # From x to y: for x north and y east this is the compass course.
    headings = (f"{x}, m", f"{y}, m", "speed, m/s", "course, °", "sigma, m", "score", "looks")
    title = f"tracks at the last look; course turns from {x} to {y}"
    table = Table(title=title, title_justify="left", box=None, pad_edge=False)
    for heading in ("track", *headings):
        table.add_column(heading, justify="right")
    for slot in live:
        mean = np.asarray(tracks.mean[slot], np.float64)
        position = mean[:2] + recording.origin_m
        sigma = np.sqrt(np.diagonal(np.asarray(tracks.covariance[slot], np.float64))[:2])
        angle = math.degrees(math.atan2(mean[3], mean[2])) % 360.0
        table.add_row(
            f"{int(tracks.identity[slot])}",
            f"{position[0]:.0f}",
            f"{position[1]:.0f}",
            f"{math.hypot(*mean[2:4]):.1f}",
            f"{angle:.1f}",
            f"{sigma[0]:.1f}, {sigma[1]:.1f}",
            f"{float(tracks.log_score[slot]):.2f}",
            f"{int(info.looks[slot])}",
        )
    console.print(table)


def print_elements(console: "Console", recording: "Recording", found: "MotionElements") -> None:
    """Print a table of the motion elements of a window's targets."""
    import numpy as np
    from rich.table import Table

    live = np.flatnonzero(np.asarray(found.tracks.mask))
    if math.isfinite(found.gate):
        console.print(f"gate {found.gate:.2f} nats of evidence", highlight=False)
    if not len(live):
        console.print("no targets")
        return
    x, y = ("x", "y") if recording.axes == "x_y" else ("north", "east")
    table = Table(title="targets", title_justify="left", box=None, pad_edge=False)
    headings = (f"first\n{x}, m", f"first\n{y}, m", f"last\n{x}, m", f"last\n{y}, m")
    for heading in ("target", *headings, f"v {x},\nm/s", f"v {y},\nm/s", "sigma, m", "score"):
        table.add_column(heading, justify="right", overflow="fold")
    for slot in live:
        first = np.asarray(found.initial[slot], np.float64)[:2] + recording.origin_m
        mean = np.asarray(found.tracks.mean[slot], np.float64)
        last = mean[:2] + recording.origin_m
        variance = np.diagonal(np.asarray(found.tracks.covariance[slot], np.float64))[:2]
        cells = [_place(value) for value in (*first, *last)] + [f"{v:.2f}" for v in mean[2:4]]
        sigma = ", ".join(f"{s:.1f}" for s in np.sqrt(variance))
        score = f"{float(found.tracks.log_score[slot]):.2f}"
        table.add_row(f"{int(found.tracks.identity[slot])}", *cells, sigma, score)
    console.print(table)


def print_lives(
    console: "Console", recording: "Recording", tracks: "Tracks", info: "TrackInfo"
) -> None:
    """Print a table of tracks: when they were there, and where they ended."""
    import numpy as np
    from rich.table import Table

    console.print(
        f"{info.confirm_score:.2f} {info.unit} confirm a track; "
        f"clutter {info.clutter_per_m2 * 1e6:.3g} a square kilometre and look",
        highlight=False,
        soft_wrap=True,
    )
    mask, identity = np.asarray(tracks.mask), np.asarray(tracks.identity)
    if not mask.any():
        console.print("no tracks")
        return
    x, y = ("x", "y") if recording.axes == "x_y" else ("north", "east")
    table = Table(title="tracks", title_justify="left", box=None, pad_edge=False)
    headings = ("from, s", "to, s", "looks", f"last\n{x}, m", f"last\n{y}, m", "speed,\nm/s")
    for heading in ("track", *headings):
        table.add_column(heading, justify="right", overflow="fold")
    time_s = np.asarray(tracks.time_s, np.float64) + recording.epoch_s
    for number in np.unique(identity[mask]):
        looks, slots = np.nonzero(mask & (identity == number))
        mean = np.asarray(tracks.mean[looks[-1], slots[-1]], np.float64)
        last = mean[:2] + recording.origin_m
        table.add_row(
            f"{number}",
            *(f"{time_s[look]:.1f}" for look in (looks[0], looks[-1])),
            f"{len(looks)}",
            *map(_place, last),
            f"{math.hypot(*mean[2:4]):.1f}",
        )
    console.print(table)


def print_files(notes: Sequence[str], out: pathlib.Path, figure: pathlib.Path | None) -> None:
    """Print what did not fit, on stderr, and which files were written."""
    from rich.console import Console

    for note in notes:
        Console(stderr=True).print(f"note: {note}", highlight=False, soft_wrap=True)
    written = f"{out}" + (f", {figure}" if figure else "")
    Console().print(written, highlight=False, soft_wrap=True)


def _place(value: float) -> str:
    """Return a coordinate: of far origins a decimal would only make the table too wide."""
    return f"{value:.1f}" if abs(value) < 1e5 else f"{value:.0f}"


def draw(
    path: pathlib.Path,
    recording: "Recording",
    tracks: "Tracks",
    smoothed_m: Any,
    title: str,
) -> None:
    """Draw looks and tracks, of a window or over time, in the user's own coordinates."""
    import numpy as np

    from jaxtrack import plots

    origin = recording.origin_m
    mean = np.array(tracks.mean, np.float64)
    mean[..., :2] += origin
    scans = recording.scans._replace(position_m=np.asarray(recording.scans.position_m) + origin)
    scene = plots.scene(
        scans,
        None,
        tracks._replace(mean=mean),
        smoothed_m=None if smoothed_m is None else np.asarray(smoothed_m, np.float64) + origin,
        title=title,
        axes=recording.axes,
    )
    scene.savefig(path)


def seed_of(seed: int) -> int:
    """Return a seed that JAX takes, or complain of it."""
    if not 0 <= seed < 2**31:
        raise ValueError(f"--seed: got {seed}, want a whole number from 0 to 2147483647")
    return seed


def line(error: Exception) -> str:
    """Return an error in one line."""
    if isinstance(error, OSError) and error.filename is not None:
        return f"{error.filename}: {error.strerror}"
    return " ".join(str(error).split())


def fail(message: str) -> int:
    """Print what is wrong and return the exit code for it."""
    print(f"jaxtrack: {message}", file=sys.stderr)
    return 2
