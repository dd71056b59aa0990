"""A study that is to have more trials goes on where it ended, and ends like one begun so."""

import json
import pathlib
import shutil

import pytest

from jaxtrack.cli import main
from jaxtrack.studies import chunk_store, chunks, run
from jaxtrack.studies.design import read_design
from jaxtrack.studies.run import open_study, run_study, status_of
from jaxtrack.studies.study_file import StudyError
from tests.studies.own_study import FILE, Killed, bytes_in, dying, results_in, written


@pytest.fixture(scope="module")
def home(tmp_path_factory):
    return tmp_path_factory.mktemp("own")


def design_with(home, trials, until=""):
    text = FILE.replace("trials = 40", f"trials = {trials}")
    if until:
        text = f"until = {{ metric = 'error_m', se = {until} }}\n{text}"
    return read_design(written(home, text))


@pytest.fixture(scope="module")
def whole(home):
    """Return the folder of a study of 60 trials that was begun so: seven chunks and a half."""
    assert run_study(design_with(home, 60), home / "whole").complete
    return home / "whole"


def computed_by(monkeypatch):
    first, inner = [], run.compute
    monkeypatch.setattr(run, "compute", lambda *a: (first.append(a[3]), inner(*a))[1])
    return first


def test_more_trials_keep_the_chunks_and_end_in_the_bytes_of_a_longer_run(
    home, whole, tmp_path, monkeypatch
):
    out = tmp_path / "out"
    assert run_study(design_with(home, 32), out).complete
    before = bytes_in(out)
    first = computed_by(monkeypatch)
    longer = run_study(design_with(home, 44), out)
    assert (longer.complete, longer.found.trials) == (True, 44)
    assert first == [32, 40]
    kept = {name: data for name, data in before.items() if not name.endswith("zarr.json")}
    assert kept.items() <= bytes_in(out).items()
    first.clear()
    assert not run_study(design_with(home, 60), out, stopped=lambda: len(first) == 1).complete
    assert first == [40]  # the last one, which was short
    assert run_study(open_study(out), out).complete
    assert first == [40, 48, 56]
    assert results_in(out) == results_in(whole)


def test_a_study_that_was_stopped_early_can_be_made_longer(home, whole, tmp_path):
    out = tmp_path / "out"
    asked = iter([False, True])
    assert not run_study(design_with(home, 44), out, stopped=lambda: next(asked)).complete
    assert run_study(design_with(home, 60), out).complete
    assert results_in(out) == results_in(whole)


def test_a_smaller_error_and_then_none_go_on(home, whole, tmp_path):
    out = tmp_path / "out"
    at = [run_study(design_with(home, 60, se), out).found.trials for se in (0.5, 0.3, 0.25)]
    assert 8 <= at[0] < at[1] < at[2] < 60
    alone = run_study(design_with(home, 60, 0.25), tmp_path / "alone")
    assert alone.found.trials == at[2]
    assert results_in(out) == results_in(tmp_path / "alone")
    assert run_study(design_with(home, 60), out).complete
    assert results_in(out) == results_in(whole)


@pytest.mark.parametrize(
    ("trials", "until", "old", "what"),
    [
        (44, "", "", "study.trials: 60 there, 44 here"),
        (80, "0.5", "", "study.trials: 60 there, 80 here; study.until: nothing there, {"),
        (60, "0.6", "0.5", "study.until.se: 0.5 there, 0.6 here"),
        (80, "0.6", "0.5", "study.trials: 60 there, 80 here"),
        (44, "0.4", "0.5", "study.trials: 60 there, 44 here"),
    ],
)
def test_what_may_end_earlier_is_refused(home, whole, tmp_path, trials, until, old, what):
    if old:
        out = tmp_path / "out"
        run_study(design_with(home, 60, old), out)
    else:
        out = shutil.copytree(whole, tmp_path / "out")
    before = bytes_in(out)
    with pytest.raises(StudyError) as error:
        run_study(design_with(home, trials, until), out)
    assert "holds another study's trials; what differs: " in str(error.value)
    assert what in str(error.value)
    assert bytes_in(out) == before


def test_another_metric_of_the_rule_is_refused(home, tmp_path):
    design = design_with(home, 60, 0.5)
    run_study(design, tmp_path)
    text = design.file.text.replace("metric = 'error_m'", "metric = 'beyond'")
    with pytest.raises(StudyError, match=r"study.until.metric: error_m there, beyond here"):
        run_study(read_design(written(home, text)), tmp_path)


def test_what_else_differs_of_a_longer_study_is_told_alone(home, whole):
    text = FILE.replace("trials = 40", "trials = 80").replace("count = 5", "count = 6")
    with pytest.raises(StudyError, match=r"what differs: study.scene.count: 5 there, 6 here$"):
        run_study(read_design(written(home, text)), whole)


@pytest.mark.parametrize("step", range(5))
def test_a_change_that_ends_at_any_step_loses_no_whole_chunk(
    home, whole, tmp_path, monkeypatch, step
):
    out = tmp_path / "out"
    assert run_study(design_with(home, 44), out).complete
    with monkeypatch.context() as within:
        within.setattr(pathlib.Path, "replace", dying(step))
        with pytest.raises(Killed):
            run_study(design_with(home, 60), out)
    assert chunks.committed(chunk_store.open_chunks(out)) == {0, 1, 2, 3, 4}
    first = computed_by(monkeypatch)
    assert run_study(design_with(home, 60), out).complete
    assert first == [40, 48, 56]
    assert results_in(out) == results_in(whole)


def test_the_file_that_is_stored_is_the_longer_one(home, tmp_path, capsys):
    out = tmp_path / "out"
    run_study(design_with(home, 32), out)
    design_with(home, 40)
    assert main(["study", "run", str(home / "study.toml"), "--out", str(out)]) == 0
    assert capsys.readouterr().out.splitlines()[0] == f"{out}: 40 of 40 trials"
    told = json.loads((out / chunks.RESULTS / "zarr.json").read_text())["attributes"]
    assert "trials = 40" in told["text"]
    assert (told["trials"], told["study"]["trials"]) == (40, 40)
    assert status_of(out).complete
    design_with(home, 32)
    assert main(["study", "run", str(home / "study.toml"), "--out", str(out)]) == 2
    assert "study.trials: 40 there, 32 here" in capsys.readouterr().err


def test_a_study_that_was_moved_goes_on_from_its_new_place(tmp_path):
    out = tmp_path / "out"
    run_study(read_design(written(tmp_path / "old", FILE)), out)
    shutil.move(tmp_path / "old", tmp_path / "new")
    assert run_study(read_design(tmp_path / "new" / "study.toml"), out).complete
    assert open_study(out).folder == tmp_path / "new"
