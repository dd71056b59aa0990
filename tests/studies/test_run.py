"""The engine of studies: draws, grids, differences, stop rules, kills, other configurations."""

import random
import shutil
import subprocess
import sys
import time

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from jaxtrack.studies import chunks, made, run, summary
from jaxtrack.studies.design import read_design
from jaxtrack.studies.run import open_study, run_study, status_of
from jaxtrack.studies.study_file import StudyError
from tests.studies.own_study import FILE, FUNCTIONS, bytes_in, environment, results_in, written

CHILD = """
import pathlib, sys
from jaxtrack.studies.design import read_design
from jaxtrack.studies.run import run_study

said = False

def say(_):
    global said
    if not said:
        print("computing", flush=True)
    said = True

run_study(read_design(pathlib.Path(sys.argv[1])), pathlib.Path(sys.argv[2]), on_progress=say)
"""


@pytest.fixture(scope="module")
def done(tmp_path_factory):
    """Return a study's design and how it ended."""
    folder = tmp_path_factory.mktemp("own")
    design = read_design(written(folder))
    return design, run_study(design, folder / "out")


def data_of(outcome):
    with chunks.dataset(outcome.store, outcome.found.trials) as data:
        return data.load()


def points(trial, sigma_m):
    key = jax.random.fold_in(jax.random.key(3), trial)
    return np.asarray(sigma_m * jax.random.normal(key, (5,)))


def test_every_method_and_cell_sees_the_draws_of_its_trial(done):
    _, outcome = done
    assert outcome.complete
    data = data_of(outcome)
    assert data["mean.error_m"].dims == ("sigma_m", "trial")
    assert data["shrunk.beyond"].dims == ("sigma_m", "shrunk.factor", "shrunk.kind", "trial")
    assert data["shrunk.beyond"].dtype == bool
    for trial in (0, 7, 8, 39):
        for sigma_m in (1.0, 4.0):
            seen = points(trial, sigma_m)
            cell = data.sel(sigma_m=sigma_m).isel(trial=trial)
            np.testing.assert_allclose(cell["mean.error_m"], abs(seen.mean()), rtol=1e-12)
            for kind, middle in (("mean", seen.mean()), ("median", np.median(seen))):
                for factor in (0.5, 0.9, 1.0):
                    one = cell.sel({"shrunk.factor": factor, "shrunk.kind": kind})
                    error = abs(factor * middle)
                    np.testing.assert_allclose(one["shrunk.error_m"], error, rtol=1e-12)
                    assert bool(one["shrunk.beyond"]) == (error > 0.5)


def test_means_errors_and_paired_differences_are_those_of_the_trials(done):
    design, outcome = done
    data = data_of(outcome)
    error = lambda x: x.std("trial", ddof=1) / np.sqrt(x.sizes["trial"])
    pair = data["shrunk.error_m"] - data["mean.error_m"]
    errors = summary.standard_errors(outcome.found)
    for name, x in (("mean.error_m", data["mean.error_m"]), ("shrunk - mean.error_m", pair)):
        np.testing.assert_allclose(outcome.found.mean[name], x.mean("trial"), rtol=1e-12)
        np.testing.assert_allclose(errors[name], error(x), rtol=1e-9)
    # On the same draws the difference is known far better than each of the two.
    at = {"sigma_m": 4.0, "shrunk.factor": 0.9, "shrunk.kind": "mean"}
    place = {"sigma_m": 1, "shrunk.factor": 1, "shrunk.kind": 0}
    alone = float(error(data["shrunk.error_m"].sel(at)))
    assert float(errors["shrunk - mean.error_m"].isel(place)) < alone / 5
    rows = list(summary.rows(design, outcome.found))
    assert len(rows) == 2 + 2 * 3 * 2
    last = {"method": "shrunk", "sigma_m": 4, "shrunk.factor": 1, "shrunk.kind": "median"}
    assert last.items() <= rows[-1].items()
    assert rows[-1]["error_m - mean"][0] == float(
        outcome.found.mean["shrunk - mean.error_m"][1, 2, 1]
    )


def test_a_traced_field_needs_no_program_of_its_own(tmp_path):
    functions = FUNCTIONS + "\n\nTRACES = []\n\n\ndef counted(points, *, factor, kind):\n"
    functions += "    TRACES.append(kind)\n    return factor * points.mean()\n"
    file = written(tmp_path, FILE.replace("mine:shrunk", "mine:counted"), functions)
    design = read_design(file)
    run_study(design, tmp_path / "out")
    traces = design.methods[1].call.__globals__["TRACES"]
    # Six cells, two static values: each is looked at once for its shape, and compiled once.
    assert sorted(traces) == ["mean", "mean", "median", "median"]


def test_it_stops_after_the_first_prefix_that_is_known_well_enough(tmp_path, done):
    _, whole = done
    data = data_of(whole)
    mine = ("mean.error_m", "shrunk.error_m")

    def widest(trials):
        part = data.isel(trial=slice(trials))
        return max(float((part[n].std("trial", ddof=1) / trials**0.5).max()) for n in mine)

    wanted = 24
    se = (widest(wanted) + min(widest(8), widest(16))) / 2
    assert widest(16) > se > widest(24)
    file = written(tmp_path, f"until = {{ metric = 'error_m', se = {se} }}\n" + FILE)
    seen = []
    outcome = run_study(read_design(file), tmp_path / "out", on_progress=seen.append)
    assert outcome.complete
    assert outcome.found.trials == wanted
    count = len(seen)
    again = run_study(read_design(file), tmp_path / "out", on_progress=seen.append)
    assert again.complete
    assert len(seen) == count  # nothing was computed
    assert status_of(tmp_path / "out").complete
    for name in mine:
        np.testing.assert_array_equal(data_of(outcome)[name], data[name].isel(trial=slice(wanted)))
    assert seen[0].total == 40
    assert all(progress.done <= progress.total <= 40 for progress in seen)


def test_a_metric_that_is_not_a_number_never_stops_a_study(tmp_path):
    text = FILE + '[metric.nothing]\nfunction = "mine:nothing"\n'
    file = written(tmp_path, "until = { metric = 'nothing', se = 1e9 }\n" + text)
    outcome = run_study(read_design(file), tmp_path / "out")
    assert outcome.found.trials == 40
    assert np.isnan(outcome.found.mean["mean.nothing"]).all()
    assert np.isfinite(outcome.found.mean["mean.error_m"]).all()


def test_a_stopped_study_goes_on_and_computes_only_what_is_missing(tmp_path, done, monkeypatch):
    design, whole = done
    asked = iter([False, True])
    outcome = run_study(design, tmp_path, stopped=lambda: next(asked))
    assert not outcome.complete
    assert outcome.found.trials == 16
    computed = []
    inner = run.compute
    monkeypatch.setattr(run, "compute", lambda *a: (computed.append(a[3]), inner(*a))[1])
    outcome = run_study(open_study(tmp_path), tmp_path)
    assert outcome.complete
    assert computed == [16, 24, 32]
    assert bytes_in(tmp_path) == bytes_in(whole.store.folder)


def test_a_truncated_chunk_is_told_and_computed_again(tmp_path, done):
    design, whole = done
    run_study(design, tmp_path)
    file = tmp_path / chunks.RESULTS / "mean.error_m" / "c" / "0" / "2"
    file.write_bytes(file.read_bytes()[:-5])
    status = status_of(tmp_path)
    assert (status.complete, status.damaged, status.found.trials) == (False, (2,), 16)
    assert run_study(design, tmp_path).complete
    assert bytes_in(tmp_path) == bytes_in(whole.store.folder)


@pytest.mark.parametrize(
    ("old", "new", "keys"),
    [
        ("seed = 3", "seed = 4", ["study.seed: 3 there, 4 here"]),
        ("count = 5", "count = 6", ["study.scene.count: 5 there, 6 here"]),
        ("[1.0, 4]", "[1.0, 5]", ["study.scene.sigma_m.grid: [1.0, 4] there, [1.0, 5] here"]),
        ("micro_batch = 4", "micro_batch = 8", ["study.micro_batch: 4 there, 8 here"]),
        ("limit_m = 0.5", "limit_m = 1", ["study.metric.beyond.limit_m: 0.5 there, 1 here"]),
        (
            "seed = 3\ntrials = 40",
            "trials = 32",
            ["study.seed: 3 there, 0 here", "study.trials: 40 there, 32 here"],
        ),
    ],
)
def test_another_configuration_is_refused_with_its_keys(tmp_path, done, old, new, keys):
    _, whole = done
    before = bytes_in(whole.store.folder)
    changed = read_design(written(tmp_path, FILE.replace(old, new)))
    with pytest.raises(StudyError) as error:
        run_study(changed, whole.store.folder)
    for key in keys:
        assert key in str(error.value)
    assert bytes_in(whole.store.folder) == before


def test_other_functions_and_other_versions_are_refused(tmp_path, done, monkeypatch):
    design, whole = done
    changed = read_design(written(tmp_path, functions=FUNCTIONS + "\n# another\n"))
    with pytest.raises(
        StudyError, match=r"differs: made_with.functions.mine.py: .* there, .* here$"
    ):
        run_study(changed, whole.store.folder)
    facts = made.decisive(design)
    monkeypatch.setattr(made, "decisive", lambda _: {**facts, "jaxlib": "0.0.1"})
    with pytest.raises(StudyError, match=r"differs: made_with.jaxlib: .* there, 0.0.1 here$"):
        run_study(design, whole.store.folder)


def test_comments_and_order_make_no_other_study(tmp_path, done):
    _, whole = done
    lines = FILE.replace("seed = 3\ntrials = 40", "# more\ntrials = 40\nseed = 3")
    design = read_design(written(tmp_path, lines))
    out = shutil.copytree(whole.store.folder, tmp_path / "out")
    assert run_study(design, out).complete
    assert status_of(out).design.file.text == lines  # the words are kept all the same


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        (
            "mine:mean",
            "mine:broken",
            r":14: method.mean.function: KeyError: 'nowhere'.*, line 41\)",
        ),
        ("mine:mean", "mine:leaves", r":14: method.mean.function: SystemExit: 3 .*, line 45\)"),
        ("mine:mean", "mine:longer", r":14: method.mean.function: .*; it was given float64\[5\]"),
        (
            'static = ["count"]',
            "",
            r":8: scene.function: TypeError: .*\(numbers are traced, unless",
        ),
        ("mine:error_m", "mine:words", r":22: metric.error_m.function: TypeError: .*"),
        (
            "mine:error_m",
            "mine:vector",
            r":22: metric.error_m.function: got float64 of shape \[5\]",
        ),
        ("mine:error_m", "mine:mixed", r":22: metric.error_m.function: got .*, want one dtype in"),
    ],
)
def test_functions_that_do_not_fit_are_named_before_anything_is_made(tmp_path, old, new, message):
    design = read_design(written(tmp_path, FILE.replace(old, new)))
    with pytest.raises(StudyError, match=message):
        run_study(design, tmp_path / "out")
    assert not (tmp_path / "out").exists()


def test_other_settings_of_jax_are_refused(done):
    design, whole = done
    name = "jax_threefry_partitionable"
    other = not getattr(jax.config, name)
    wanted = pytest.raises(StudyError, match=f"what differs: made_with.settings.{name}: ")
    with jax.threefry_partitionable(other), wanted:
        run_study(design, whole.store.folder)


def test_metadata_says_what_made_it(done):
    design, outcome = done
    told = outcome.store.attributes
    assert told["study"] == design.config
    assert told["made_with"]["jaxlib"] == jax.lib.__version__
    assert told["made_with"]["dtype"] == str(jnp.zeros(()).dtype)
    assert {"cpu", "device", "processor", "source", "functions"} <= told["made_with"].keys()
    assert told["about"]["xarray"]
    assert told["labels"]["shrunk.kind"] == ["mean", "median"]
    assert open_study(outcome.store.folder).config == design.config


def killed_and_resumed(tmp_path, kills, seed):
    """Return the bytes of a study that was killed so often, and of one that was not."""
    trials = 8 * 30 * (kills + 1)
    design = read_design(written(tmp_path, FILE.replace("trials = 40", f"trials = {trials}")))
    whole, out = tmp_path / "whole", tmp_path / "out"
    seen = []
    assert run_study(design, whole, on_progress=lambda _: seen.append(time.perf_counter())).complete
    # Half of what there is time for: a child on a quieter machine must not come to its end.
    span_s = (seen[-1] - seen[0]) / (2 * (kills + 1))
    draw = random.Random(seed)
    died = 0
    for turn in range(kills):
        child = subprocess.Popen(
            [sys.executable, "-c", CHILD, str(tmp_path / "study.toml"), str(out)],
            env=environment(devices=(1, 2, 4)[turn % 3]),
            stdout=subprocess.PIPE,
            text=True,
        )
        with child:
            assert child.stdout.readline() == "computing\n"
            time.sleep(span_s * draw.random())
            child.kill()
            child.wait()
        died += child.returncode == -9
    assert died == kills
    status = status_of(out)
    assert status.damaged == ()
    assert status.found is None or status.found.trials < trials
    assert run_study(design, out).complete
    return results_in(out), results_in(whole)


def test_a_study_killed_three_times_ends_in_the_same_bytes(tmp_path):
    resumed, whole = killed_and_resumed(tmp_path, 3, seed=0)
    assert resumed == whole


@pytest.mark.slow
def test_a_study_killed_twenty_times_ends_in_the_same_bytes(tmp_path):
    resumed, whole = killed_and_resumed(tmp_path, 20, seed=1)
    assert resumed == whole


@pytest.mark.slow
@pytest.mark.parametrize("devices", [1, 2, 4])
def test_the_number_of_devices_changes_no_bit(tmp_path, done, devices):
    design, whole = done
    file, out = design.folder / "study.toml", tmp_path / "out"
    subprocess.run(
        [sys.executable, "-c", CHILD, str(file), str(out)],
        env=environment(devices),
        check=True,
        capture_output=True,
    )
    assert results_in(out) == results_in(whole.store.folder)


def test_the_rate_leaves_out_the_first_chunk_and_counts_those_of_other_processes(done, monkeypatch):
    design, _ = done
    clock, seen = [0.0], []
    monkeypatch.setattr(run.time, "perf_counter", lambda: clock[0])
    reporter = run._Reporter(design, seen.append)
    for first, begin, end in ((0, 0.0, 9.0), (16, 10.0, 11.0), (32, 12.0, 14.0)):
        clock[0] = begin
        reporter.begin(first, first + 8, None)
        clock[0] = end
        reporter.report(1.0)
    # Chunks 1 and 3 are another process's; 24 trials have come in four seconds.
    assert [progress.rate for progress in seen] == [8 / 9, 8 / 1, 24 / 4]
    assert [progress.done for progress in seen] == [8, 24, 40]
