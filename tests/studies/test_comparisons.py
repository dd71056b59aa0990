"""What a study is compared with: read, told by line, shown with verdicts, decides no result."""

import math
import pathlib

import numpy as np
import pytest

from jaxtrack.studies import run
from jaxtrack.studies.design import design_of, read_design
from jaxtrack.studies.report import study as study_report
from jaxtrack.studies.study_file import StudyError
from tests.studies.own_study import COMPARE, FILE, bytes_in, written
from tests.studies.reading import checked

TRIALS = 40


@pytest.fixture(scope="module")
def ran(tmp_path_factory):
    """Return a study that is complete, as it stands, and its trials by variable."""
    home = tmp_path_factory.mktemp("compared")
    run.run_study(read_design(written(home, FILE + COMPARE)), home / "out")
    outcome = run.status_of(home / "out")
    return outcome, {name: np.asarray(array[...]) for name, array in outcome.store.arrays.items()}


def tables_of(outcome):
    page = checked(study_report.report_of(outcome, outcome.store.folder))
    return {t["caption"]: t["rows"] for t in page.tables}, page.text


def test_a_figure_is_of_the_cells_that_are_named():
    printed, words, rival, _ = design_of(FILE + COMPARE, pathlib.Path(), functions=False).compare
    at = lambda sigma_m, factor, kind: printed.at(
        {"sigma_m": sigma_m, "shrunk.factor": factor, "shrunk.kind": kind}
    )
    assert (at(1.0, 0.5, "mean"), at(1.0, 1, "mean"), at(4, 0.5, "mean")) == (0.18, 0.36, 0.71)
    assert at(4, 1, "mean") is None  # nan
    assert at(1.0, 0.9, "mean") is at(1.0, 0.5, "median") is None
    assert (printed.methods, words.methods, rival.methods) == (("shrunk",), ("mean",), ("shrunk",))
    assert (words.metrics, words.at({"sigma_m": 4})) == (("error_m", "beyond"), "poor")
    assert (rival.variable, words.variable) == ("mean.error_m", None)


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ('name = "paper"', "name = 3", "1.name: got 3, want text"),
        ('source = "table', 'sourc = "table', "1.sourc: unknown key, want one of name, source"),
        ('metric = "error_m"', 'metric = "error"', "1.metric: got 'error', want one or several of"),
        ('method = "shrunk"', "method = []", "1.method: got [], want one or several of mean, shr"),
        ("cells = {", "cells = 3 # {", "1.cells: got 3, want { field = value or [value"),
        ("sigma_m = [1.0, 4.0]", "sigma = [1.0, 4.0]", "1.cells.sigma: no field with a grid"),
        (
            "= [1.0, 4.0], shrunk",
            "= [1.0, 2.0], shrunk",
            "1.cells.sigma_m: got (1.0, 2.0), want of",
        ),
        ("[[0.18, 0.36], [0.71, nan]]", "[0.18]", "1.value: got [0.18], want a list of 2"),
        ("[0.71, nan]]", "0.71]", "1.value: got 0.71, want a list of 2, as in cells"),
        ("[0.71, nan]]", "[0.71, true]]", "1.value: got True, want a number or text"),
        ('value = "poor"', "", "2: got none of them, want one of value, at_least, at_most"),
        ('value = "poor"', "value = 1\nat_most = 2", "2: got value and at_most, want one of"),
        ('value = "poor"', "value = [1, 2]", "2.value: got [1, 2], want a number or text"),
        ('"mean.error_m"', '"best"', "3.at_most: got 'best', want a number, a list, or a variable"),
        ("[0.5, 0.1]", '["a", 0.1]', "4.at_most: got 'a', want a number"),
    ],
)
def test_what_is_wrong_is_told_with_line_and_key(old, new, message):
    text = FILE + COMPARE.replace(old, new, 1)
    with pytest.raises(StudyError) as error:
        design_of(text, pathlib.Path(), "mine.toml", functions=False)
    place, found = str(error.value).split(": compare.")
    assert found.startswith(message)
    lines = text.split("\n")
    blocks = [n for n, line in enumerate(lines, 1) if line == "[[compare]]"]
    line, number = int(place.removeprefix("mine.toml:")), int(message[0])
    assert blocks[number - 1] <= line < [*blocks, len(lines)][number]
    word = message[2:].split(":")[0].rpartition(".")[2]
    assert message[1] == ":" or lines[line - 1].startswith((word, "cells"))


def test_a_variable_wants_its_own_grid():
    text = FILE + COMPARE.replace('at_most = "mean', 'method = "mean"\nat_most = "shrunk')
    with pytest.raises(StudyError, match=r"3\.at_most: got shrunk\.error_m, want another one"):
        design_of(text, pathlib.Path(), functions=False)
    with pytest.raises(StudyError, match="compare: want tables, each under"):
        design_of(f"compare = 3\n{FILE}", pathlib.Path(), functions=False)


def test_ours_stand_beside_the_others_with_verdicts(ran):
    outcome, values = ran
    tables, text = tables_of(outcome)
    heads, *lines = tables["error_m: ours and others"]
    fields = ["method", "sigma_m", "shrunk.factor", "shrunk.kind"]
    assert heads == [*fields, "ours", "95 %", "paper", "rival", "verdict"]
    assert [line[6] for line in lines if line[6]] == ["poor", ".18", ".36", ".71"]
    means = values["mean.error_m"].mean(-1)
    seen = set()
    for place, line in zip(np.ndindex(2, 3, 2), lines[1:], strict=True):  # the mean of σ 4 is first
        ours = values["shrunk.error_m"][place]
        less = ours - values["mean.error_m"][place[0]]
        reach = 1.96 * less.std(ddof=1) / math.sqrt(TRIALS)
        assert line[8] == ("fails" if less.mean() - reach > 0 else "pass")
        sign, mean, *_ = line[7].split(" ")
        assert (sign, float(mean)) == ("≤", pytest.approx(means[place[0]], rel=6e-3))
        low, high = map(float, line[5].split(" … "))
        assert low < ours.mean() < high
        seen.add(line[8])
    assert seen == {"pass", "fails"}
    missed = tables["error_m: missed"][1:]
    assert missed == [line for line in lines if line[8] == "fails"]
    assert "paper: table 4, of 100 runs; rival: on the same draws" in text


def test_shares_have_wilsons_interval_and_the_page_counts_verdicts(ran):
    outcome, values = ran
    tables, text = tables_of(outcome)
    lines = tables["beyond: ours and others"][1:]
    z, n = 1.959964, TRIALS
    flat = [*values["mean.beyond"], *values["shrunk.beyond"].reshape(12, TRIALS)]
    for line, hits in zip(lines, flat, strict=True):
        p = hits.mean()
        middle = (p + z * z / (2 * n)) / (1 + z * z / n)
        reach = z * math.sqrt(p * (1 - p) / n + z * z / (4 * n * n)) / (1 + z * z / n)
        bound = {"≤ .5": 0.5, "≤ .1": 0.1}[line[7]]
        assert line[8] == ("pass" if middle - reach <= bound else "fails")
        low, high = map(float, line[5].split(" … "))
        assert (low, high) == pytest.approx((middle - reach, middle + reach), abs=6e-4)
    words = [row[8] for name in ("error_m", "beyond") for row in tables[f"{name}: ours and others"]]
    told = f"Of what is wanted: {words.count('pass')} reached, {words.count('fails')} missed"
    assert told in text
    assert {"≤ .5", "≤ .1"} == {line[7] for line in lines}


def test_few_trials_give_no_verdict(ran, tmp_path):
    design = read_design(written(tmp_path, FILE + COMPARE))
    asked = iter([False, True])
    run.run_study(design, tmp_path / "part", stopped=lambda: next(asked))
    tables, text = tables_of(run.status_of(tmp_path / "part"))
    assert {row[8] for row in tables["beyond: ours and others"][1:]} == {"smoke"}
    assert "Of what is wanted: 26 open (fewer than 20 trials)" in text
    assert "beyond: missed" not in tables


def test_other_comparisons_go_with_the_same_results(ran, tmp_path):
    folder = tmp_path / "out"
    run.run_study(read_design(written(tmp_path, FILE)), folder)
    before = bytes_in(folder)
    assert not [row for row in tables_of(run.status_of(folder))[0] if "others" in row]
    outcome = run.run_study(read_design(written(tmp_path, FILE + COMPARE)), folder)
    assert outcome.complete
    after = bytes_in(folder)
    differing = [name for name in before | after if before.get(name) != after.get(name)]
    assert differing == ["results.zarr/zarr.json"]
    found, wanted = (tables_of(outcome)[0] for outcome in (run.status_of(folder), ran[0]))
    names = [name for name in wanted if "others" in name or "missed" in name]
    assert len(names) == 4
    assert all(found[name] == wanted[name] for name in names)


def test_curves_have_the_papers_points_hollow(ran):
    outcome, _ = ran
    page = checked(study_report.report_of(outcome, outcome.store.folder))
    told = [a["aria-label"] for tag, a in page.tags if tag == "svg" and "aria-label" in a]
    (over,) = [x for x in told if x.startswith("error_m against shrunk.factor, sigma_m 1.0")]
    assert "others of shrunk, kind mean: 0.18 at 0.5, 0.36 at 1" in over
    assert "others of shrunk, kind median" not in over
    assert page.text.count("Hollow: paper.") == 3  # of the error, over each field
    hollow = [a for tag, a in page.tags if tag == "path" and "scale" in a.get("transform", "")]
    assert len(hollow) == 3 + 3 + 2  # over sigma_m two of six curves are left out
    assert {a["fill"] for a in hollow} == {"none"}
