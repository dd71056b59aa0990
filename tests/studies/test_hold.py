"""A study's folder: held by one run, mended where it is damaged, read where none can write."""

import errno
import json
import os
import pathlib
import shutil
import subprocess
import sys
import tempfile

import pytest

from jaxtrack.cli import main
from jaxtrack.studies import chunk_store, chunks, run
from jaxtrack.studies.design import read_design
from jaxtrack.studies.hold import LOCK, held
from jaxtrack.studies.run import open_study, run_study, status_of
from jaxtrack.studies.study_file import StudyError
from tests.studies.own_study import (
    FILE,
    Killed,
    as_nobody,
    bytes_in,
    dying,
    environment,
    results_in,
    written,
)


@pytest.fixture(scope="module")
def done(tmp_path_factory):
    """Return a study's design and the folder in which it is complete."""
    folder = tmp_path_factory.mktemp("own")
    design = read_design(written(folder))
    assert run_study(design, folder / "out").complete
    return design, folder / "out"


def copied(done, tmp_path):
    return shutil.copytree(done[1], tmp_path / "out")


def computed_by(monkeypatch):
    """Return a list of the first trials of all chunks that are computed from now on."""
    first, inner = [], run.compute
    monkeypatch.setattr(run, "compute", lambda *a: (first.append(a[3]), inner(*a))[1])
    return first


def test_from_making_to_the_end_no_other_run_gets_the_folder(done, tmp_path, monkeypatch):
    design, whole = done
    seen = []

    def watched(module, name):
        inner = getattr(module, name)

        def watching(*arguments, **named):
            with pytest.raises(StudyError, match="another run is at work there"):
                run_study(design, tmp_path / "out")
            seen.append(name)
            return inner(*arguments, **named)

        monkeypatch.setattr(module, name, watching)

    watched(chunk_store, "create")
    watched(chunks, "clean")
    watched(chunks, "write")
    assert run_study(design, tmp_path / "out").complete
    assert seen == ["create", "clean", *["write"] * 5]
    assert bytes_in(tmp_path / "out") == bytes_in(whole)


def test_of_two_runs_begun_at_once_one_has_the_folder(tmp_path):
    file = written(tmp_path, FILE.replace("trials = 40", "trials = 480"))
    command = [sys.executable, "-m", "jaxtrack.cli", "study", "run", str(file), "--out", "out"]
    settings = {"cwd": tmp_path, "env": environment(1), "stderr": subprocess.PIPE, "text": True}
    pair = [subprocess.Popen(command, stdout=subprocess.DEVNULL, **settings) for _ in range(2)]
    complaints = [process.communicate()[1] for process in pair]
    codes = [process.returncode for process in pair]
    assert sorted(codes) in ([0, 0], [0, 2])  # one may have begun after the other's end
    for code, complaint in zip(codes, complaints, strict=True):
        if code:
            assert complaint == "jaxtrack: out: another run is at work there\n"
    assert run_study(read_design(file), tmp_path / "whole").complete
    assert results_in(tmp_path / "out") == results_in(tmp_path / "whole")


def test_a_lock_that_is_shared_keeps_others_out_all_the_time(tmp_path):
    refused = pytest.raises(StudyError, match="another run is at work there")
    with held(tmp_path, alone=True) as share:
        with pytest.raises(StudyError), held(tmp_path, alone=False):
            pass
        share()
        with held(tmp_path, alone=False), refused, held(tmp_path, alone=True):
            pass
    assert [path.name for path in tmp_path.iterdir()] == [LOCK]


def harm_folder(array):
    shutil.rmtree(array)


def harm_description(array):
    (array / "zarr.json").unlink()


def harm_truncated(array):
    file = array / "zarr.json"
    file.write_bytes(file.read_bytes()[:-40])


def harm_other_shape(array):
    file = array / "zarr.json"
    meta = json.loads(file.read_text())
    meta["shape"][-1] = 39
    file.write_text(json.dumps(meta))


@pytest.mark.parametrize(
    ("harm", "begun"),
    [
        (harm_folder, [0, 8, 16, 24, 32]),
        (harm_description, []),  # trials are there, and fit their records
        (harm_truncated, []),
        (harm_other_shape, []),
    ],
)
def test_an_array_that_is_missing_is_found_and_made_anew(done, tmp_path, monkeypatch, harm, begun):
    _, whole = done
    out = copied(done, tmp_path)
    harm(out / chunks.RESULTS / "mean.error_m")
    status = status_of(out)
    assert (status.complete, status.damaged, status.found) == (False, (0, 1, 2, 3, 4), None)
    first = computed_by(monkeypatch)
    assert run_study(open_study(out), out).complete
    assert first == begun
    assert bytes_in(out) == bytes_in(whole)
    assert status_of(out).complete


def test_a_store_without_arrays_and_records_is_filled_again(done, tmp_path):
    design, whole = done
    out = copied(done, tmp_path)
    for path in (out / chunks.RESULTS).iterdir():
        if path.is_dir():
            shutil.rmtree(path)
    assert len(status_of(out).damaged) == 5
    shutil.rmtree(out / chunks.COMMITS)
    assert status_of(out).found is None
    assert run_study(design, out).complete
    assert bytes_in(out) == bytes_in(whole)


@pytest.mark.parametrize("step", range(5))
def test_a_mending_that_ends_at_any_step_is_gone_on_with(done, tmp_path, monkeypatch, step):
    design, whole = done
    out = copied(done, tmp_path)
    harm_folder(out / chunks.RESULTS / "mean.error_m")
    with monkeypatch.context() as within:
        within.setattr(pathlib.Path, "replace", dying(step))
        with pytest.raises(Killed):
            run_study(design, out)
    assert len(chunks.committed(chunk_store.open_chunks(out))) == 5
    assert run_study(design, out).complete
    assert bytes_in(out) == bytes_in(whole)


@pytest.mark.parametrize("name", ["text", "folder", "variables", "trials", "chunk"])
def test_an_attribute_that_is_missing_is_said(done, tmp_path, capsys, name):
    design, whole = done
    out = copied(done, tmp_path)
    meta = out / chunks.RESULTS / "zarr.json"
    root = json.loads(meta.read_text())
    del root["attributes"][name]
    meta.write_text(json.dumps(root))
    for action in ("status", "report", "resume"):
        assert main(["study", action, str(out)]) == 2
        reason = f"jaxtrack: {out / chunks.RESULTS}: its attribute {name} is missing\n"
        assert capsys.readouterr().err == reason
    if name in ("text", "folder"):  # the file itself mends it
        assert run_study(design, out).complete
        assert bytes_in(out) == bytes_in(whole)


def test_a_description_of_the_store_that_is_cut_off_is_said(done, tmp_path, capsys):
    out = copied(done, tmp_path)
    meta = out / chunks.RESULTS / "zarr.json"
    meta.write_bytes(meta.read_bytes()[:100])
    for action in ("status", "report", "resume"):
        assert main(["study", action, str(out)]) == 2
        err = capsys.readouterr().err
        assert err.startswith(f"jaxtrack: {meta}: cannot be read: ")
        assert len(err.splitlines()) == 1


@pytest.mark.parametrize("with_lock", [True, False])
def test_a_complete_study_where_none_can_write_is_read_and_reported(with_lock, capsys):
    with tempfile.TemporaryDirectory() as name:
        folder = pathlib.Path(name) / "out"
        design = read_design(written(pathlib.Path(name)))
        assert run_study(design, folder).complete
        if not with_lock:
            (folder / LOCK).unlink()
        elsewhere = pathlib.Path(name) / "elsewhere"
        elsewhere.mkdir()
        before = bytes_in(folder)
        paths = [folder.parent, *folder.parent.rglob("*")]
        for path in paths:
            path.chmod(0o555 if path.is_dir() else 0o444)
        elsewhere.chmod(0o777)
        try:
            with as_nobody():
                assert run_study(design, folder).complete
                assert main(["study", "status", str(folder)]) == 0
                assert capsys.readouterr().out.splitlines()[-1] == "complete"
                assert main(["study", "report", str(folder)]) == 2
                assert "report.html" in capsys.readouterr().err
                assert main(["study", "report", str(folder), "--out", str(elsewhere)]) == 0
                assert (elsewhere / "report.html").is_file()
                longer = read_longer(design)
                with pytest.raises(StudyError, match="cannot be written: Permission denied"):
                    run_study(longer, folder)
        finally:
            for path in paths:
                path.chmod(0o755)
        assert bytes_in(folder) == before


def read_longer(design):
    text = design.file.text.replace("trials = 40", "trials = 48")
    return design._replace(
        trials=48, config={**design.config, "trials": 48}, file=design.file._replace(text=text)
    )


def test_a_full_disk_stops_no_study_that_is_complete(done, tmp_path, monkeypatch):
    design, _ = done
    out = copied(done, tmp_path)

    def full(*_, **__):
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))

    monkeypatch.setattr(tempfile, "NamedTemporaryFile", full)
    monkeypatch.setattr(chunks, "write", full)
    monkeypatch.setattr(os, "fsync", full)
    assert run_study(design, out).complete
    (out / chunks.COMMITS / "00000003.json").unlink()
    with pytest.raises(StudyError, match="cannot be written: No space left on device; what is"):
        run_study(design, out)
