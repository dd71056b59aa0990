"""`jaxtrack study`, the page of the documentation on it, and the study that comes along."""

import errno
import io
import os
import pathlib
import re
import shutil
import signal
import subprocess
import sys
import time

import jax
import numpy as np
import pytest

from jaxtrack.cli import main
from jaxtrack.cli.study import progress_text
from jaxtrack.studies import chunk_store, chunks, run
from jaxtrack.studies.design import read_design
from jaxtrack.studies.functions import shipped_study
from jaxtrack.studies.hold import LOCK
from jaxtrack.studies.run import Progress
from jaxtrack.studies.trials import programs_of, variables_of
from tests.studies.own_study import FILE, bytes_in, environment, write_documented, written

JOINT = ("--coordinator-address", "here", "--num-processes", "2", "--process-id")


@pytest.fixture
def study(tmp_path, monkeypatch, capsys):
    """Return a runner `study(*arguments) -> (exit code, stdout, stderr)`, beside a study's file."""
    written(tmp_path)
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("COLUMNS", "200")

    def study(*arguments):
        code = main(["study", *arguments])
        out, err = capsys.readouterr()
        assert "Traceback" not in out + err
        return code, out, err

    return study


def test_a_study_of_ones_own_runs_and_is_shown(study):
    code, out, err = study("run", "study.toml")
    assert (code, err) == (0, "")
    lines = out.splitlines()
    assert lines[0] == "results/study: 40 of 40 trials"
    heads = "method  sigma_m  shrunk.factor  shrunk.kind  error_m  beyond  error_m - mean"
    assert lines[1].split()[:7] == heads.replace("error_m - mean", "error_m").split()
    assert lines[-1] == "complete"
    assert len(lines) == 1 + 1 + 14 + 1
    assert study("status", "results/study") == (0, out, "")
    assert study("resume", "results/study") == (0, out, "")


def test_an_interrupt_ends_after_the_chunk_and_says_how_to_go_on(study, monkeypatch):
    write, written_chunks = chunks.write, []

    def interrupted(store, number, values):
        if number == 1:
            os.kill(os.getpid(), signal.SIGINT)
        write(store, number, values)
        written_chunks.append(number)

    with monkeypatch.context() as within:
        within.setattr(chunks, "write", interrupted)
        code, out, err = study("run", "study.toml", "--out", "here")
    assert code == 130
    assert written_chunks == [0, 1]
    assert "ends after this chunk" in err
    assert out.splitlines()[0] == "here: 16 of 40 trials"
    assert out.splitlines()[-1] == "to go on: jaxtrack study resume here"
    code, out, _ = study("resume", "here")
    assert (code, out.splitlines()[0]) == (0, "here: 40 of 40 trials")
    study("run", "study.toml")
    assert bytes_in(pathlib.Path("here")) == bytes_in(pathlib.Path("results/study"))


def test_a_second_interrupt_ends_at_once(study, monkeypatch):
    def interrupted(store, number, values):
        os.kill(os.getpid(), signal.SIGINT)
        # Two that come before Python has heard the first one are one.
        while signal.getsignal(signal.SIGINT) is not signal.default_int_handler:
            time.sleep(0.01)
        os.kill(os.getpid(), signal.SIGINT)
        time.sleep(10.0)

    monkeypatch.setattr(chunks, "write", interrupted)
    # What a shell starts in the background ignores interrupts.
    before = signal.signal(signal.SIGINT, signal.default_int_handler)
    try:
        code, _, err = study("run", "study.toml")
        assert code == 130
        assert "jaxtrack: interrupted" in err
        assert signal.getsignal(signal.SIGINT) is signal.default_int_handler
    finally:
        signal.signal(signal.SIGINT, before)


def test_damage_is_shown(study):
    study("run", "study.toml", "--out", "here")
    (pathlib.Path("here") / "results.zarr" / "mean.beyond" / "c" / "0" / "1").write_bytes(b"")
    _, out, _ = study("status", "here")
    assert out.splitlines()[0] == "here: 8 of 40 trials"
    assert "damaged, computed again when resumed: chunk 1" in out
    assert "jaxtrack study resume here" in out


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (("run", "nowhere.toml"), "nowhere.toml: No such file"),
        (("run", "nowhere"), "nowhere: no such file, and no study of that name; there are: ccm, "),
        (("run", "wrong.toml"), "wrong.toml:3: trials: got 0"),
        (("resume", "nowhere"), "nowhere: there is no study here"),
        (("status", "nowhere"), "nowhere: there is no study here"),
        (("status", "nowhere", "--out", "x"), "--out: is for run and report; status takes"),
        (("status", "nowhere", "--process-id", "0"), "--coordinator-address, --num-processes"),
        (("run", "study.toml", "--process-id", "0"), "--coordinator-address: is missing; "),
        (("run", "study.toml", *JOINT, "1"), "--coordinator-address: got here, want HOST:PORT"),
    ],
)
def test_users_errors_are_one_line(study, arguments, message):
    pathlib.Path("wrong.toml").write_text(FILE.replace("trials = 40", "trials = 0"))
    code, out, err = study(*arguments)
    assert (code, out) == (2, "")
    assert len(err.splitlines()) == 1
    assert err.startswith(f"jaxtrack: {message}")


def test_a_full_disk_is_one_line_and_the_study_goes_on_later(study, monkeypatch):
    sync, calls = os.fsync, 0

    def full(handle):
        nonlocal calls
        calls += 1
        if calls == 50:
            raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))
        sync(handle)

    with monkeypatch.context() as within:
        within.setattr(os, "fsync", full)
        code, out, err = study("run", "study.toml", "--out", "here")
    assert (code, out) == (2, "")
    reason = "could not be written: No space left on device; what was stored before is whole"
    assert re.fullmatch(rf"jaxtrack: here: trials \d+ to \d+ {reason}\n", err)
    whole = chunks.committed(chunk_store.open_chunks(pathlib.Path("here")))
    assert whole == set(range(int(re.search(r"trials (\d+)", err)[1]) // 8)) != set()
    assert study("resume", "here")[0] == 0
    study("run", "study.toml")
    assert bytes_in(pathlib.Path("here")) == bytes_in(pathlib.Path("results/study"))


@pytest.mark.parametrize("action", ["run", "resume", "status"])
def test_a_store_of_another_version_is_one_line_and_stays(study, tmp_path, action):
    store = chunk_store.create(
        tmp_path / "here",
        {"mean.error_m": chunks.Variable((), (), "float32")},
        trials=40,
        chunk=8,
        attributes={},
    )
    meta = store.folder / chunks.RESULTS / "zarr.json"
    meta.write_text(meta.read_text().replace('"format": 2', '"format": 9'))
    before = bytes_in(tmp_path / "here")
    target = ("study.toml", "--out", "here") if action == "run" else ("here",)
    code, out, err = study(action, *target)
    reason = "here: the store has format 9, this version of jaxtrack reads 2"
    assert (code, out, err) == (2, "", f"jaxtrack: {reason}\n")
    assert bytes_in(tmp_path / "here") == before | ({LOCK: b""} if action == "run" else {})


def test_functions_that_are_gone_are_an_error_and_lose_nothing(study, tmp_path):
    study("run", "study.toml", "--out", "here")
    before = bytes_in(tmp_path / "here")
    pathlib.Path("mine.py").unlink()
    code, _, err = study("resume", "here")
    assert code == 2
    assert "here's study:8: scene.function: No module named 'mine'" in err
    code, out, _ = study("status", "here")  # needs none of them
    assert (code, out.splitlines()[0]) == (0, "here: 40 of 40 trials")
    assert bytes_in(tmp_path / "here") == before


def test_progress_is_one_line_with_what_is_left():
    text = progress_text(Progress(250.0, 1000.0, 0.1, ("mean.error_m", 1.25, 0.031)))
    assert text == "25 %, 250 of 1000 trials, 0.1 a second, 2 hours left, mean.error_m 1.25 ± .031"
    assert (
        progress_text(Progress(0.0, 10.0, 0.0, None)) == "0 %, 0 of 10 trials, 0 a second, ? left"
    )


@pytest.mark.parametrize("width", range(24, 90))
def test_progress_in_little_room_keeps_what_counts(width):
    last = ("neutrosophic.position_ospa_m", 1.25, 0.031)
    text = progress_text(Progress(250.0, 1000.0, 50.0, last), width)
    assert len(text) <= width
    assert text.startswith("25 %, 50 a second, 15 s")
    if width > 46:
        assert text.startswith("25 %, 50 a second, 15 s left, ")
        assert text.endswith(" 1.25 ± .031")
    if width > 71:
        assert text.endswith(", neutrosophic.position_ospa_m 1.25 ± .031")
    assert progress_text(Progress(250.0, 1000.0, 50.0, last), 200).count("of 1000 trials") == 1


class Terminal(io.StringIO):
    def isatty(self):
        return True


def test_a_terminal_gets_one_line_that_is_drawn_again(study, monkeypatch):
    screen = Terminal()
    monkeypatch.setattr(sys, "stderr", screen)
    monkeypatch.setenv("COLUMNS", "30")
    assert study("run", "study.toml")[0] == 0
    drawn = screen.getvalue().split("\r\x1b[K")
    assert drawn[0] == drawn[-1] == ""
    assert re.match(r"\d+ %, \S+ a second, ", drawn[1])
    assert max(map(len, drawn)) <= 29
    assert "\n" not in screen.getvalue()


def test_a_variable_that_is_gone_is_said_and_computed_again(study, tmp_path):
    _, out, _ = study("run", "study.toml", "--out", "here")
    shutil.rmtree(tmp_path / "here" / "results.zarr" / "mean.error_m")
    _, told, _ = study("status", "here")
    assert "damaged, computed again when resumed: chunk 0 to 4" in told
    assert study("resume", "here") == (0, out, "")


def test_progress_comes_with_every_chunk(tmp_path):
    seen = []
    design = read_design(written(tmp_path))
    run.run_study(design, tmp_path / "out", on_progress=seen.append)
    done = [progress.done for progress in seen]
    assert done == sorted(done)
    assert done[-1] == 40.0
    assert {8.0, 16.0, 24.0, 32.0} <= set(done)
    assert all(progress.rate > 0 for progress in seen)
    assert seen[0].last is None
    assert seen[-1].last[0] in ("mean.error_m", "shrunk.error_m")


def test_the_example_of_the_documentation_is_true(tmp_path):
    text = write_documented(tmp_path)
    command = [sys.executable, "-m", "jaxtrack.cli", "study", "run", "middles.toml"]
    settings = {"cwd": tmp_path, "capture_output": True, "text": True, "check": True}
    single = {**environment(1), "JAX_ENABLE_X64": "0"}
    out = subprocess.run(command, env=single, **settings).stdout.splitlines()
    first = text.index("    results/middles")
    told = [line.strip() for line in text[first:].split("\n\n")[0].splitlines()]
    assert len(out) == len(told) == 13
    assert out[0] == told[0]
    assert out[1].split() == told[1].split()
    numbers = lambda line: [float(x) for x in re.findall(r"-?\d*\.\d+", line)]
    for ours, theirs in zip(out, told, strict=True):
        np.testing.assert_allclose(numbers(ours), numbers(theirs), atol=0.002)
    read = [sys.executable, "read.py"]
    assert subprocess.run(read, env=single, **settings).stdout.startswith("[[0.")


def test_the_study_that_comes_along_fits_its_functions():
    design = read_design(shipped_study("crossing"))
    variables = variables_of(design, programs_of(design))
    assert set(variables) == {"improved.found", "improved.false", "joint.found", "joint.false"}
    assert variables["joint.found"].dims == ("sigma_m", "joint.gate")
    assert jax.numpy.issubdtype(variables["joint.found"].dtype, jax.numpy.integer)


@pytest.mark.slow
def test_the_study_that_comes_along_runs_by_its_name(study):
    code, out, _ = study("run", "crossing")
    assert code == 0
    assert out.splitlines()[0].startswith("results/crossing: ")
    found = [float(line.split()[3]) for line in out.splitlines() if line.startswith("joint")]
    assert len(found) == 6
    assert min(found) > 2.5
