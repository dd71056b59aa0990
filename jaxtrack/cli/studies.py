"""Commands on the studies: list, reproduce."""

import os
import pathlib
import platform
import shlex
import time
from importlib import metadata

from jaxtrack.cli.screen import (
    console_of_tables,
    fail,
    line,
    progress,
    seed_of,
    use_all_cores,
)


def list_studies() -> int:
    """List the studies: what they reproduce, how many trials they run, how long they take."""
    from rich.table import Table

    from jaxtrack.studies import STUDIES

    table = Table("name", "study, source", box=None, pad_edge=False)
    for title in ("trials", "seconds", "trials\nin full", "seconds\nin full"):
        table.add_column(title, justify="right", no_wrap=True)
    for study in STUDIES.values():
        numbers = (study.trials_short, study.seconds_short, study.trials_full, study.seconds_full)
        what = f"{study.title}\n{study.source}"
        table.add_row(study.name, what, *(f"{x:,.0f}" for x in numbers))
    console_of_tables().print(table)
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

    At the end all that the folder holds is one page, report.html.

    Args:
        names: which studies; none: all of them.
        trials: trials a cell, instead of the study's own number.
        full: run the stated numbers of trials instead of the short ones.
        seed: of every study.
        out: the folder that gets a folder for each study.
    """
    from rich.console import Console

    use_all_cores()
    import jax

    from jaxtrack.studies import STUDIES, Context, shown
    from jaxtrack.studies.parts import FOLDER
    from jaxtrack.studies.report.papers import write_page
    from jaxtrack.studies.tables import duration

    console, errors = console_of_tables(), Console(stderr=True)
    unknown = [name for name in names if name not in STUDIES]
    if unknown:
        known = ", ".join(STUDIES)
        return fail(f"there is no study {', '.join(unknown)}; there are: {known}")
    if trials is not None and trials < 1:
        return fail(f"--trials: got {trials}, want at least 1")
    if trials is not None and full:
        return fail("--trials, --full: got both, want one of them")
    try:
        seed_of(seed)
    except ValueError as error:
        return fail(line(error))
    studies = [STUDIES[name] for name in dict.fromkeys(names or STUDIES)]

    devices = jax.devices()
    packages = ("jaxtrack", "jax", "numpy")
    versions = ", ".join(f"{name} {metadata.version(name)}" for name in packages)
    versions += f", Python {platform.python_version()}"
    console.print(f"seed {seed}; {versions}", highlight=False)
    kind = f"{len(devices)} × {devices[0].device_kind} device"
    console.print(kind, highlight=False)
    if full:
        seconds = sum(study.seconds_full for study in studies)
        console.print(f"The full run takes about {duration(seconds)} on two cores.")
    page = ""
    for study in studies:
        console.rule(f"{study.name}: {study.title}", align="left")
        count = trials or (study.trials_full if full else study.trials_short)
        folder = out / study.name
        try:
            folder.mkdir(parents=True, exist_ok=True)
            if (folder / "commits").exists():
                taken = "holds a study that `jaxtrack study` keeps: give another --out"
                return fail(f"{folder}: {taken}")
        except OSError as error:
            return fail(line(error))
        about = {
            "seed": seed,
            "trials": count,
            "versions": versions,
            "devices": kind,
            "command": f"jaxtrack reproduce {study.name} --trials {count} --seed {seed}"
            f" --out {shlex.quote(str(out))}",
            "resumed": (folder / FOLDER).exists(),
        }
        begun = time.perf_counter()
        with progress(errors) as report, shown.recorded(console) as seen:
            study.run(Context(folder, count, seed, console, report))
        shown.save(folder, seen, about, time.perf_counter() - begun)
        console.print(f"{folder}{os.sep}", highlight=False)
        try:  # after each study, lest an interrupt leave the ones before without
            page = write_page(out, STUDIES)
        except OSError as error:
            return fail(line(error))
    console.print(page, highlight=False, soft_wrap=True)
    return 0
