"""What results were made with: what decides their bits, and what is good to know."""

import functools
import inspect
import os
import pathlib
import re
import subprocess
from collections.abc import Mapping
from typing import Any

import jax

from jaxtrack.studies.design import Design
from jaxtrack.studies.functions import digest_of, files_of, own_file
from jaxtrack.studies.store import made_with, source_digest

_ABSENT = "nothing"
_PACKAGE = pathlib.Path(__file__).parents[1]
# Settings of JAX that change draws or sums.
_SETTINGS = (
    "jax_default_prng_impl",
    "jax_threefry_partitionable",
    "jax_default_matmul_precision",
)


def decisive(design: Design) -> dict[str, Any]:
    """Return what two runs must share for their trials to be the same bit for bit.

    Example:
        >>> from jaxtrack.studies.design import read_design
        >>> from jaxtrack.studies.functions import shipped_study
        >>> decisive(read_design(shipped_study("crossing")))["dtype"]
        'float32'
    """
    made = made_with()
    names = ("jaxtrack", "jax", "jaxlib", "numpy", "processor", "dtype")
    # How many devices there are decides nothing, and says nothing about the compiler.
    flags = re.sub(
        r"--xla_force_host_platform_device_count=\S*", "", os.environ.get("XLA_FLAGS", "")
    )
    return {
        **{name: made[name] for name in names},
        "device": sorted(set(made["devices"])),
        "cpu": _cpu(),
        "xla_flags": " ".join(sorted(flags.split())),
        "settings": {name: str(getattr(jax.config, name)) for name in _SETTINGS},
        "source": source_digest(),
        "functions": {name: digest_of(file) for name, file in sorted(_files(design).items())},
    }


def about(design: Design) -> dict[str, Any]:
    """Return what is good to know of where results come from, and decides nothing."""
    files = [_PACKAGE / "__init__.py", *_files(design).values()]
    revisions = {str(file): _revision(file) for file in sorted(files)}
    return {**made_with(), "git": revisions}


def differences(there: Any, here: Any, path: str = "") -> list[str]:
    """Return in words in which keys two tables differ.

    Example:
        >>> differences({"a": {"b": 1, "c": 2}}, {"a": {"b": 1, "c": 3}})
        ['a.c: 2 there, 3 here']
    """
    if isinstance(there, Mapping) and isinstance(here, Mapping):
        keys = [*there, *(key for key in here if key not in there)]
        at = lambda key: f"{path}.{key}" if path else str(key)
        return [
            line
            for key in keys
            for line in differences(there.get(key, _ABSENT), here.get(key, _ABSENT), at(key))
        ]
    return [] if there == here else [f"{path}: {_short(there)} there, {_short(here)} here"]


def _short(value: Any) -> str:
    text = str(value)
    return text if len(text) <= 60 else f"{text[:28]}…{text[-28:]}"


def _files(design: Design) -> dict[str, pathlib.Path]:
    """Return the files from outside the package in which a study's functions stand, by name.

    Beside the study's file they come with what they import from there.
    """
    found: dict[str, pathlib.Path] = {}
    for part in (design.scene, *design.methods, *design.metrics):
        own = own_file(part.function, design.folder)
        if own is not None:
            found |= {file.relative_to(design.folder).as_posix(): file for file in files_of(own)}
        elif (file := _file(part.call)) is not None and _PACKAGE not in file.parents:
            found[part.function.partition(":")[0]] = file
    return found


def _file(function: Any) -> pathlib.Path | None:
    """Return the file in which a function stands, if it is written in Python."""
    while isinstance(function, functools.partial):
        function = function.func
    try:
        file = pathlib.Path(inspect.getsourcefile(inspect.unwrap(function)) or "").resolve()
    except TypeError:
        return None
    return file if file.is_file() else None


@functools.cache
def _cpu() -> str:
    """Return the processor's instruction sets, for which XLA compiles, where the system tells."""
    try:
        text = pathlib.Path("/proc/cpuinfo").read_text(encoding="utf-8")
    except OSError:
        return ""
    found = re.search(r"^(?:flags|Features)\s*:\s*(.*)$", text, re.MULTILINE)
    return " ".join(sorted(found[1].split())) if found else ""


def _revision(file: pathlib.Path) -> str | None:
    """Return the git revision of a file that git knows."""

    def git(*arguments: str) -> str:
        command = ["git", "-C", str(file.parent), *arguments]
        return subprocess.run(command, capture_output=True, text=True, check=True).stdout.strip()

    try:
        git("ls-files", "--error-unmatch", file.name)
        return git("describe", "--always", "--dirty", "--abbrev=40")
    except (OSError, subprocess.CalledProcessError):
        return None
