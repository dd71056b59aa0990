"""Commands on the studies: list, reproduce."""

import os
import pathlib
import platform
from importlib import metadata

from jaxtrack.cli.screen import (
    console_of_tables,
    duration,
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

    from jaxtrack.studies import STUDIES, Context

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
    console.print(f"seed {seed}; {versions}, Python {platform.python_version()}", highlight=False)
    console.print(f"{len(devices)} × {devices[0].device_kind} device", highlight=False)
    if full:
        seconds = sum(study.seconds_full for study in studies)
        console.print(f"The full run takes about {duration(seconds)} on two cores.")
    for study in studies:
        console.rule(f"{study.name}: {study.title}", align="left")
        count = trials or (study.trials_full if full else study.trials_short)
        folder = out / study.name
        try:
            folder.mkdir(parents=True, exist_ok=True)
        except OSError as error:
            return fail(line(error))
        with progress(errors) as report:
            study.run(Context(folder, count, seed, console, report))
        console.print(f"{folder}{os.sep}", highlight=False)
    return 0
