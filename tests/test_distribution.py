"""Wheel and sdist: built from the checkout, installed and used where there is none."""

import pathlib
import subprocess
import sys
import sysconfig
import tarfile
import venv
import zipfile

import pytest

from tests.studies.own_study import environment, written

ROOT = pathlib.Path(__file__).resolve().parent.parent
# What an estimator needs, and nothing else.
USE = """
import jax, jaxtrack
from jaxtrack import hough, sensors
scene = sensors.crossing_targets("I")
scans = sensors.observe(jax.random.key(0), scene.truth, scene.radar, detections=4)
params = hough.improved.ImprovedParams(peaks=hough.Peaks(gate=4.0))
sizes = hough.Sizes(pairs=16, rho=160, theta=105)
lines, _ = jax.jit(lambda scans: hough.improved.estimate(scans, params, sizes=sizes))(scans)
assert int(lines.mask.sum()) == 3
sensors.radar_measurements()
print(jaxtrack.__file__)
"""
SECONDS = """
import time
import jax
begun = time.process_time()
import jaxtrack
print(time.process_time() - begun)
"""


# The command line, where of the extras only `studies` is there.
STUDY = """
import sys
sys.modules |= dict.fromkeys(("flax", "flatbuffers", "matplotlib", "optuna"))
from jaxtrack.cli import main
sys.exit(main(["study", "run", "study.toml"]))
"""


def build(source, folder, *targets):
    options = [word for target in targets for word in ("-t", target)]
    command = [sys.executable, "-m", "hatchling", "build", "-d", str(folder), *options]
    subprocess.run(command, cwd=source, check=True, capture_output=True)


def contents(wheel):
    """What a wheel installs, by name."""
    with zipfile.ZipFile(wheel) as archive:
        names = [name for name in archive.namelist() if not name.endswith("/RECORD")]
        return {name: archive.read(name) for name in names}


@pytest.fixture(scope="module")
def built(tmp_path_factory):
    """Return the wheel and the sdist."""
    folder = tmp_path_factory.mktemp("built")
    build(ROOT, folder, "wheel", "sdist")
    return next(folder.glob("*.whl")), next(folder.glob("*.tar.gz"))


@pytest.fixture(scope="module")
def python(built, tmp_path_factory):
    """Return a Python of its own that has the wheel, and all else from the one that tests."""
    folder = tmp_path_factory.mktemp("env")
    venv.create(folder, with_pip=False, symlinks=True)
    own = folder / "bin" / "python"
    version = f"python{sys.version_info.major}.{sys.version_info.minor}"
    site = folder / "lib" / version / "site-packages"
    # A path in a .pth file brings packages along, but no .pth file of theirs: the checkout's stays
    # away.
    paths = sysconfig.get_paths()
    (site / "all_else.pth").write_text(f"{paths['purelib']}\n{paths['platlib']}\n")
    pip = [sys.executable, "-m", "pip", "--python", str(own), "install", "--quiet"]
    offline = ["--no-deps", "--no-index", "--ignore-installed", "--disable-pip-version-check"]
    subprocess.run([*pip, *offline, str(built[0])], check=True, capture_output=True)
    return own


@pytest.fixture
def run(python, tmp_path):
    """Return a runner of commands of that Python's in an empty folder: `run(*words) -> output`."""
    settings = environment(1)
    del settings["PYTHONPATH"]

    def run(*words, code=0):
        done = subprocess.run(
            [str(python.parent / words[0]), *words[1:]],
            cwd=tmp_path,
            capture_output=True,
            text=True,
            env={**settings, "COLUMNS": "200"},
        )
        assert done.returncode == code, done.stderr
        return done.stdout + done.stderr

    return run


def test_the_wheel_has_every_file_of_the_package(built):
    there = {
        str(path.relative_to(ROOT))
        for path in (ROOT / "jaxtrack").rglob("*")
        if path.is_file() and "__pycache__" not in path.parts
    }
    assert any(name.endswith("csht_estimation.toml") for name in there)
    inside = contents(built[0])
    assert {name for name in inside if ".dist-info/" not in name} == there


def test_the_sdist_builds_the_same_wheel(built, tmp_path):
    with tarfile.open(built[1]) as archive:
        archive.extractall(tmp_path, filter="data")
    (source,) = tmp_path.iterdir()
    assert (source / "tests" / "conftest.py").is_file()
    build(source, tmp_path / "again", "wheel")
    assert contents(next((tmp_path / "again").glob("*.whl"))) == contents(built[0])


def test_the_wheel_is_used_outside_the_checkout(run, python):
    where = pathlib.Path(run("python", "-W", "error", "-c", USE).strip())
    assert python.parent.parent in where.parents


def test_an_import_takes_a_moment_longer_than_jax(run):
    seconds = min(float(run("python", "-c", SECONDS)) for _ in range(3))
    assert seconds < 0.15


def test_a_study_of_ones_own_runs_from_the_wheel(run, tmp_path):
    written(tmp_path)
    out = run("python", "-c", STUDY)
    assert "results/study: 40 of 40 trials" in out
    assert out.splitlines()[-1] == "complete"
    assert run("jaxtrack", "study", "status", "results/study") == out
    assert "there are: ccm, " in run("jaxtrack", "study", "run", "nowhere", code=2)
