"""The command line: start tracks in a file, list the studies, reproduce them.

Thin on purpose: it reads options, calls the library and prints. Users' errors are one line on
stderr and exit code 2.
"""

import contextlib
import math
import os
import pathlib
import platform
import sys
import time
from collections.abc import Callable, Iterator, Sequence
from importlib import metadata
from typing import TYPE_CHECKING, Any, Literal

if TYPE_CHECKING:
    from rich.console import Console

    from jaxtrack.io import Recording
    from jaxtrack.tracking import WindowInfo
    from jaxtrack.types import Tracks

_SAY_AFTER_S = 30.0  # without a terminal, progress is a line that often
_EXTRAS = ("tyro", "rich", "matplotlib", "mpl_toolkits", "xarray", "zarr")


def main(argv: Sequence[str] | None = None) -> int:
    """Run the command line.

    Args:
        argv: arguments; None: those of the process.

    Returns:
        0, 2 for a user's error, or 130 after Ctrl-C.
    """
    try:
        import tyro

        commands = {"initiate": initiate, "list": list_studies, "reproduce": reproduce}
        return tyro.extras.subcommand_cli_from_dict(
            commands,  # pyright: ignore[reportArgumentType]
            prog="jaxtrack",
            description="Estimators for tracking in sonar and radar data.",
            args=argv,
        )
    except ModuleNotFoundError as error:
        if (error.name or "").partition(".")[0] not in _EXTRAS:
            raise
        return _fail(f"{error.name} is not installed: pip install 'jaxtrack[studies,plots]'")
    except KeyboardInterrupt:
        print("jaxtrack: interrupted", file=sys.stderr)
        return 130
    except SystemExit as error:  # --help, or options that tyro has already complained of
        return error.code if isinstance(error.code, int) else 2


def initiate(
    file: pathlib.Path,
    /,
    *,
    method: Literal["joint", "neutrosophic", "improved", "modified", "standard"] = "joint",
    out: pathlib.Path = pathlib.Path("tracks.csv"),
    figure: pathlib.Path | None = None,
    speed_min_m_s: float = 100.0,
    speed_max_m_s: float = 400.0,
    sigma_m: float = 10.0,
    p_detect: float = 0.9,
    false_per_run: float = 0.01,
    bearing: Literal["clockwise_from_north", "math"] = "clockwise_from_north",
    max_tracks: int = 8,
    seed: int = 0,
) -> int:
    """Start tracks in a file of detections; all its looks form one window.

    Args:
        file: CSV, one detection a row: time_s and x_m, y_m or range_m, bearing_deg; where there
            are, scan, weight, sigma_m or cov_xx_m2, cov_xy_m2, cov_yy_m2 and, with bearings,
            sigma_range_m, sigma_bearing_deg, own_x_m, own_y_m, own_heading_deg.
        method: how detections vote for tracks; joint is the best, the others are the paper's.
        out: where the tracks go, CSV.
        figure: a map of detections and tracks goes here (PNG, PDF or SVG).
        speed_min_m_s: slowest target, m/s.
        speed_max_m_s: fastest target, m/s.
        sigma_m: standard deviation of each coordinate of a detection, m; more where targets bend.
        p_detect: probability that a target is detected in a look.
        false_per_run: wanted mean number of false tracks in such a file; the gate comes from
            simulated scenes with the file's clutter and no targets.
        bearing: how bearings in the file are counted, degrees.
        max_tracks: most tracks that are looked for.
        seed: of the simulated scenes.
    """
    from rich.console import Console

    _use_all_cores()
    import jax

    from jaxtrack.hough import SpeedGate
    from jaxtrack.io import read_detections, write_tracks
    from jaxtrack.tracking import initiate_window

    console, errors = Console(), Console(stderr=True)
    if figure is not None:
        # A missing matplotlib, or a kind of file it does not know, shows before the computation.
        from jaxtrack import plots

        kinds = (".png", ".pdf", ".svg")
        if figure.suffix.lower() not in kinds:
            return _fail(f"--figure: got {figure}, want a name that ends in {', '.join(kinds)}")
    for path in (out, figure):
        if path is not None and not path.parent.is_dir():
            return _fail(f"{path}: there is no folder {path.parent}")
        if path is not None and path.is_dir():
            return _fail(f"{path}: got a folder, want the name of a file")
    if out.exists() and file.exists() and out.samefile(file):
        return _fail(f"--out: got {out}, which is the file of detections itself")
    try:
        recording = read_detections(file, bearing=bearing)
        with _progress(errors) as report:
            tracks, info = initiate_window(
                recording.scans,
                method=method,
                speed=SpeedGate(speed_min_m_s, speed_max_m_s),
                sigma_m=sigma_m,
                p_detect=p_detect,
                false_per_run=false_per_run,
                max_tracks=max_tracks,
                key=jax.random.key(_seed(seed)),
                on_progress=lambda done, total: report("scenes without targets", done, total),
            )
        write_tracks(out, tracks, recording)
        if figure is not None:
            _draw(plots, figure, recording, tracks, info, f"{file.name}, {method}")
    except (OSError, ValueError) as error:  # a DataError is a ValueError
        return _fail(_line(error))
    _print_tracks(console, recording, tracks, info, seed)
    for note in info.notes:
        errors.print(f"note: {note}", highlight=False, soft_wrap=True)
    console.print(f"{out}" + (f", {figure}" if figure else ""), highlight=False, soft_wrap=True)
    return 0


def list_studies() -> int:
    """List the studies: what they reproduce, how many trials they run, how long they take."""
    from rich.console import Console
    from rich.table import Table

    from jaxtrack.studies import STUDIES

    table = Table("name", "study, source", box=None, pad_edge=False)
    for title in ("trials", "seconds", "trials\nin full", "seconds\nin full"):
        table.add_column(title, justify="right", no_wrap=True)
    for study in STUDIES.values():
        numbers = (study.trials_short, study.seconds_short, study.trials_full, study.seconds_full)
        what = f"{study.title}\n{study.source}"
        table.add_row(study.name, what, *(f"{x:,.0f}" for x in numbers))
    Console().print(table)
    return 0


def reproduce(
    names: tuple[str, ...] = (),
    /,
    *,
    trials: int | None = None,
    full: bool = False,
    seed: int = 0,
    out: pathlib.Path = pathlib.Path("results"),
) -> int:
    """Run studies; tables go to the screen, tables and figures into a folder a study.

    Args:
        names: which studies; none: all of them.
        trials: trials a cell, instead of the study's own number.
        full: run the stated numbers of trials instead of the short ones.
        seed: of every study.
        out: the folder that gets a folder for each study.
    """
    from rich.console import Console

    _use_all_cores()
    import jax

    from jaxtrack.studies import STUDIES, Context

    console, errors = Console(), Console(stderr=True)
    unknown = [name for name in names if name not in STUDIES]
    if unknown:
        known = ", ".join(STUDIES)
        return _fail(f"there is no study {', '.join(unknown)}; there are: {known}")
    if trials is not None and trials < 1:
        return _fail(f"--trials: got {trials}, want at least 1")
    if trials is not None and full:
        return _fail("--trials, --full: got both, want one of them")
    try:
        _seed(seed)
    except ValueError as error:
        return _fail(_line(error))
    studies = [STUDIES[name] for name in dict.fromkeys(names or STUDIES)]

    devices = jax.devices()
    packages = ("jaxtrack", "jax", "numpy")
    versions = ", ".join(f"{name} {metadata.version(name)}" for name in packages)
    console.print(f"seed {seed}; {versions}, Python {platform.python_version()}", highlight=False)
    console.print(f"{len(devices)} × {devices[0].device_kind} device", highlight=False)
    if full:
        seconds = sum(study.seconds_full for study in studies)
        console.print(f"The full run takes about {_duration(seconds)} on two cores.")
    for study in studies:
        console.rule(f"{study.name}: {study.title}", align="left")
        count = trials or (study.trials_full if full else study.trials_short)
        folder = out / study.name
        try:
            folder.mkdir(parents=True, exist_ok=True)
        except OSError as error:
            return _fail(_line(error))
        with _progress(errors) as report:
            study.run(Context(folder, count, seed, console, report))
        console.print(f"{folder}{os.sep}", highlight=False)
    return 0


def _use_all_cores() -> None:
    """Make every core a device of JAX; too late, and left alone, once JAX has been used."""
    import jax

    from jaxtrack.montecarlo.advice import available_cores

    cores = available_cores()
    with contextlib.suppress(RuntimeError):
        jax.config.update("jax_num_cpu_devices", cores)


@contextlib.contextmanager
def _progress(console: "Console") -> Iterator[Callable[[str, int, int], None]]:
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


def _print_tracks(
    console: "Console",
    recording: "Recording",
    tracks: "Tracks",
    info: "WindowInfo",
    seed: int,
) -> None:
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


def _draw(
    plots: Any,
    path: pathlib.Path,
    recording: "Recording",
    tracks: "Tracks",
    info: "WindowInfo",
    title: str,
) -> None:
    """Draw the scene in the user's own coordinates."""
    import numpy as np

    origin = recording.origin_m
    mean = np.array(tracks.mean, np.float64)
    mean[:, :2] += origin
    scans = recording.scans._replace(position_m=recording.scans.position_m + origin)
    scene = plots.scene(
        scans,
        None,
        tracks._replace(mean=mean),
        smoothed_m=np.asarray(info.smoothed_m, np.float64) + origin,
        title=title,
        axes=recording.axes,
    )
    scene.savefig(path)


def _duration(seconds: float) -> str:
    return f"{seconds:.0f} s" if seconds < 120 else f"{seconds / 60:.0f} minutes"


def _seed(seed: int) -> int:
    if not 0 <= seed < 2**31:
        raise ValueError(f"--seed: got {seed}, want a whole number from 0 to 2147483647")
    return seed


def _line(error: Exception) -> str:
    if isinstance(error, OSError) and error.filename is not None:
        return f"{error.filename}: {error.strerror}"
    return " ".join(str(error).split())


def _fail(message: str) -> int:
    print(f"jaxtrack: {message}", file=sys.stderr)
    return 2


if __name__ == "__main__":
    sys.exit(main())
