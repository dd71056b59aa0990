"""A study of one's own, as tests write it into a folder: its functions and its file."""

import contextlib
import json
import os
import pathlib
import re
from collections.abc import Callable

import jax

FUNCTIONS = """
import jax
import jax.numpy as jnp

from beside import absolute


def points(key, *, sigma_m, count):
    return sigma_m * jax.random.normal(key, (count,))


def mean(points):
    return points.mean()


def shrunk(points, *, factor, kind="mean"):
    return factor * (points.mean() if kind == "mean" else jnp.median(points))


def error_m(points, estimate):
    return absolute(estimate)


def beyond(points, estimate, *, limit_m):
    return absolute(estimate) > limit_m


def nothing(points, estimate):
    return jnp.where(estimate > 0, estimate, jnp.nan)


def vector(points, estimate):
    return points


def words(points, estimate):
    return "far"


def broken(points):
    raise KeyError("nowhere")


def leaves(points):
    raise SystemExit(3)


def stops(points):
    raise KeyboardInterrupt


def longer(points):
    return points + jnp.zeros(7)


def mixed(points, estimate):
    return MIXED.pop()


MIXED = [1, 2.0, 1, 2.0]


def later(points, estimate):
    like = jax.ShapeDtypeStruct((), float)
    return jax.pure_callback(fails, like, estimate, vmap_method="sequential")


def fails(estimate):
    raise RuntimeError("no luck")
"""
BESIDE = "import jax.numpy as jnp\n\n\ndef absolute(x):\n    return jnp.abs(x)\n"
FILE = """
seed = 3
trials = 40
chunk = 8
micro_batch = 4

[scene]
function = "mine:points"
sigma_m = { grid = [1.0, 4] }
count = 5
static = ["count"]

[method.mean]
function = "mine:mean"

[method.shrunk]
function = "mine:shrunk"
factor = { grid = [0.5, 0.9, 1] }
kind = { grid = ["mean", "median"] }

[metric.error_m]
function = "mine:error_m"

[metric.beyond]
function = "mine:beyond"
limit_m = 0.5
"""
COMPARE = """
[[compare]]
name = "paper"
source = "table 4, of 100 runs"
metric = "error_m"
method = "shrunk"
cells = { sigma_m = [1.0, 4.0], shrunk.factor = [0.5, 1.0], shrunk.kind = "mean" }
value = [[0.18, 0.36], [0.71, nan]]

[[compare]]
name = "paper"
metric = ["error_m", "beyond"]
method = "mean"
cells = { sigma_m = 4 }
value = "poor"

[[compare]]
name = "rival"
source = "on the same draws"
metric = "error_m"
at_most = "mean.error_m"

[[compare]]
name = "wanted"
source = "fixed < beforehand"
metric = "beyond"
method = ["mean", "shrunk"]
cells = { sigma_m = [1.0, 4.0] }
at_most = [0.5, 0.1]
"""


def written(folder: pathlib.Path, file: str = FILE, functions: str = FUNCTIONS) -> pathlib.Path:
    """Write a study into a folder and return its file."""
    folder.mkdir(parents=True, exist_ok=True)
    (folder / "mine.py").write_text(functions)
    (folder / "beside.py").write_text(BESIDE)
    path = folder / "study.toml"
    path.write_text(file)
    return path


def write_documented(folder: pathlib.Path) -> str:
    """Write the files that the documentation shows into a folder and return its text."""
    text = (pathlib.Path(__file__).parents[2] / "docs" / "studies.md").read_text()
    for block in re.findall(r"```\w+\n(.*?)```", text, re.DOTALL):
        (folder / re.search(r"^# (\S+\.\w+)$", block, re.MULTILINE)[1]).write_text(block)
    return text


def bytes_in(folder: pathlib.Path) -> dict[str, bytes]:
    """Return what all files of a folder hold, by name."""
    return {
        str(path.relative_to(folder)): path.read_bytes()
        for path in sorted(folder.rglob("*"))
        if path.is_file()
    }


def results_in(folder: pathlib.Path) -> dict[str, bytes]:
    """Return the same, without what tells of the machine: how many devices there were."""
    found = bytes_in(folder)
    root = json.loads(found.pop("results.zarr/zarr.json"))
    assert root["attributes"].pop("about")["devices"]
    return {**found, "root": json.dumps(root).encode()}


def environment(devices: int) -> dict[str, str]:
    """Return the environment in which another process computes the same bits as this one."""
    # Workers of a parallel test run are told a width of their own.
    inherited = {name: value for name, value in os.environ.items() if name != "COLUMNS"}
    return {
        **inherited,
        "JAX_ENABLE_X64": "1",
        "JAX_NUM_CPU_DEVICES": str(devices),
        "JAX_COMPILATION_CACHE_DIR": str(jax.config.jax_compilation_cache_dir),
        "JAX_PERSISTENT_CACHE_MIN_COMPILE_TIME_SECS": "0",
        "PYTHONPATH": str(pathlib.Path(__file__).parents[2]),
    }


@contextlib.contextmanager
def as_nobody():
    """Be a user whom permissions bind, which root is not."""
    root = os.geteuid() == 0
    if root:
        os.seteuid(65534)
    try:
        yield
    finally:
        if root:
            os.seteuid(0)


class Killed(BaseException):
    """What no handler of errors sees."""


def dying(step: int) -> Callable[[pathlib.Path, pathlib.Path], pathlib.Path]:
    """Return a `Path.replace` that dies when this many descriptions of arrays are replaced."""
    replace, left = pathlib.Path.replace, step

    def replaced(self: pathlib.Path, target: pathlib.Path) -> pathlib.Path:
        nonlocal left
        if self.name == "zarr.json":
            if left == 0:
                raise Killed
            left -= 1
        return replace(self, target)

    return replaced
