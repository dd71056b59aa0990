"""The report of a study from a file: what stands in it, and that it says it truly."""

import json
import os
import pathlib
import re
import shutil

import numpy as np
import pytest

from jaxtrack.cli import main
from jaxtrack.studies import chunk_store, chunks, run, summary
from jaxtrack.studies.design import read_design
from jaxtrack.studies.report import runs as report_runs
from jaxtrack.studies.report import study as study_report
from jaxtrack.studies.report.curves import steps
from jaxtrack.studies.report.html_page import folded, table
from jaxtrack.studies.report.runs import trials_for
from tests.studies.own_study import FILE, bytes_in, written
from tests.studies.reading import checked


@pytest.fixture(scope="module")
def ran(tmp_path_factory):
    """Return the folder of a study that is complete, and one that stopped after two chunks."""
    home = tmp_path_factory.mktemp("study")
    design = read_design(written(home, "# a < b & <script>alert(1)</script>\n" + FILE))
    run.run_study(design, home / "whole")
    asked = iter([False, True])
    run.run_study(design, home / "part", stopped=lambda: next(asked))
    return home


@pytest.fixture
def whole(ran):
    return run.status_of(ran / "whole")


def page_of(outcome, folder):
    return checked(study_report.report_of(outcome, folder))


def test_a_complete_study_is_reported_by_a_command(ran, tmp_path, capsys):
    folder = shutil.copytree(ran / "whole", tmp_path / "whole")
    before = bytes_in(folder)
    assert main(["study", "report", str(folder)]) == 0
    out, err = capsys.readouterr()
    assert re.fullmatch(rf"{re.escape(str(folder))}/report\.html \(\d+ kB\)\n", out)
    assert err == ""
    after = bytes_in(folder)
    text = after.pop("report.html").decode()
    assert after == before  # nothing else is touched
    page = checked(text)
    assert "40 of 40 trials, seed 3." in page.text
    assert "Not complete" not in page.text
    names = ["Results", "Figures", "Atlas", "How many runs do I need", "The study's file"]
    found = [heading for level, heading in page.headings if level == 2]
    assert found == [*names, "How it was made", "How to run it again"]


def test_a_folder_without_a_study_is_one_line(tmp_path, capsys):
    assert main(["study", "report", str(tmp_path)]) == 2
    assert capsys.readouterr().err == f"jaxtrack: {tmp_path}: there is no study here\n"


def test_the_table_has_every_mean_and_paired_difference(whole, ran):
    page = page_of(whole, ran / "whole")
    heads, *lines = page.tables[0]["rows"]
    rows = list(summary.rows(whole.design, whole.found))
    assert heads[:4] == ["method", "sigma_m", "shrunk.factor", "shrunk.kind"]
    assert heads[4:] == ["error_m", "beyond", "error_m - mean", "beyond - mean"]
    assert len(lines) == len(rows) == 14
    for line, row in zip(lines, rows, strict=True):
        for head, cell in zip(heads, line, strict=True):
            if head not in row:
                assert cell == ""
            elif isinstance(row[head], tuple):
                mean, error = (float(x) for x in cell.split(" ± "))
                np.testing.assert_allclose((mean, error), row[head], rtol=6e-3, atol=6e-4)
            else:
                assert cell == str(row[head])


def test_what_a_user_wrote_is_shown_and_not_obeyed(whole, ran):
    text = study_report.report_of(whole, ran / "whole")
    assert "<script>alert" not in text
    assert FILE.strip() in checked(text).text
    assert "# a < b & <script>alert(1)</script>" in checked(text).text


def test_a_study_that_is_not_complete_says_so_and_how_to_go_on(ran):
    folder = ran / "part"
    outcome = run.status_of(folder)
    page = page_of(outcome, folder)
    assert "16 of 40 trials, seed 3." in page.text
    assert f"Not complete. To go on: jaxtrack study resume {folder}" in page.text
    assert "Means over 16 trials" in page.tables[0]["caption"]
    page = page_of(outcome._replace(damaged=(1, 3)), folder)
    assert "Damaged, computed again when resumed: chunk 1, 3." in page.text


def test_a_study_without_a_trial_still_has_a_page(ran, tmp_path):
    folder = shutil.copytree(ran / "whole", tmp_path / "none")
    for file in (folder / "commits").iterdir():
        file.unlink()
    page = page_of(run.status_of(folder), folder)
    assert "0 of 40 trials" in page.text
    assert page.tables == []
    assert FILE.strip() in page.text


def test_one_trial_has_no_errors_and_no_promises(tmp_path):
    text = FILE.replace("trials = 40", "trials = 1")
    run.run_study(read_design(written(tmp_path, text)), tmp_path / "one")
    page = page_of(run.status_of(tmp_path / "one"), tmp_path / "one")
    assert all("± –" in cell for row in page.tables[0]["rows"][1:] for cell in row if "±" in cell)
    assert "nan" not in page.text
    assert "inf" not in page.text


def test_a_study_without_a_grid_has_neither_figures_nor_atlas(tmp_path):
    text = re.sub(r"\{ grid = \[(\S+?),?( .*)?\] \}", r"\1", FILE)
    run.run_study(read_design(written(tmp_path, text)), tmp_path / "plain")
    page = page_of(run.status_of(tmp_path / "plain"), tmp_path / "plain")
    assert len(page.tables[0]["rows"]) == 1 + 2
    assert not {"Figures", "Atlas"} & {heading for _, heading in page.headings}


def test_figures_show_every_mean_with_two_errors(whole, ran):
    page = page_of(whole, ran / "whole")
    told = [a["aria-label"] for tag, a in page.tags if tag == "svg" and "aria-label" in a]
    assert len(told) == 2 * (1 + 2 + 2)  # a metric: over σ, over two fields at both σ
    mean = whole.found.mean["shrunk.error_m"].values
    line = next(x for x in told if x.startswith("error_m against shrunk.factor, sigma_m 4"))
    values = [
        float(x) for x in re.findall(r"kind median: (\S+) at .*?, (\S+) at .*?, (\S+) at", line)[0]
    ]
    np.testing.assert_allclose(values, mean[1, :, 1], rtol=6e-3)


def test_axes_have_round_numbers_around_what_is_drawn():
    rng = np.random.default_rng(0)
    for low, span in zip(rng.normal(0, 100, 300), 10 ** rng.uniform(-6, 6, 300), strict=True):
        ticks = steps(low, low + span)
        assert 3 <= len(ticks) <= 9
        assert ticks[0] <= low + 1e-6 * span
        assert ticks[-1] >= low + span * (1 - 1e-6)
    for same in (0.0, 3.0, -2.0):
        assert steps(same, same)[0] < same < steps(same, same)[-1]


def test_the_atlas_comes_with_all_maps_and_shows_the_first(whole, ran):
    text = study_report.report_of(whole, ran / "whole")
    page = checked(text)
    data = json.loads(re.search(r'id="atlas-data">(.*?)</script>', text, re.DOTALL)[1])
    maps = {(one["metric"], one["what"]): one for one in data["maps"]}
    assert set(maps) == {(m, w) for m in ("error_m", "beyond") for w in ("shrunk", "shrunk − mean")}
    one = maps["error_m", "shrunk"]
    assert one["axes"] == ["sigma_m", "shrunk.factor", "shrunk.kind"]
    assert one["labels"] == [["1.0", "4"], ["0.5", "0.9", "1"], ["mean", "median"]]
    mean = whole.found.mean["shrunk.error_m"].values
    told = np.array([float(x.split(" ± ")[0]) for x in one["text"]]).reshape(mean.shape)
    np.testing.assert_allclose(told, mean, rtol=6e-3)
    shade = np.array(one["shade"]).reshape(mean.shape)
    np.testing.assert_allclose(shade, (mean - mean.min()) / np.ptp(mean), atol=1e-3)
    assert (np.array(one["kind"]).reshape(mean.shape) == "strong").sum() == (shade > 0.65).sum()
    apart = maps["error_m", "shrunk − mean"]
    mean = whole.found.mean["shrunk - mean.error_m"].values.ravel()
    assert [("minus" in kind) for kind in apart["kind"]] == (mean < 0).tolist()
    np.testing.assert_allclose(apart["shade"], np.abs(mean) / np.abs(mean).max(), atol=1e-3)
    shown = next(t for t in page.tables if "down" in t["caption"])
    assert shown["caption"] == (
        "error_m, shrunk: sigma_m down, shrunk.factor across; shrunk.kind = mean"
    )
    assert shown["rows"][1][1:] == [one["text"][n] for n in (0, 2, 4)]
    assert shown["rows"][2][1:] == [one["text"][n] for n in (6, 8, 10)]


def test_trials_wanted_follow_the_square_root():
    rng = np.random.default_rng(1)
    values = rng.normal(3.0, 2.0, 400)
    spread = values.std(ddof=1)
    error = spread / 20
    assert trials_for(spread, error) == 400
    assert trials_for(spread, error / 2) == 1600
    assert trials_for(spread, error / 10) == 40000
    assert trials_for(spread, 1e9) == 1
    for spread, wanted in ((0.0, 0.1), (np.inf, 0.1), (1.0, 0.0), (np.nan, 0.1)):
        assert np.isnan(trials_for(spread, wanted))


def test_how_many_runs_is_reckoned_from_the_cell_known_least_and_from_the_pairs(whole, ran):
    page = page_of(whole, ran / "whole")
    of = lambda start: next(t["rows"] for t in page.tables if t["caption"].startswith(start))
    errors = summary.standard_errors(whole.found)["shrunk.error_m"]
    mean = whole.found.mean["shrunk.error_m"].values.ravel()
    cell = errors.values.argmax()
    spread = errors.values.ravel()[cell] * np.sqrt(40)
    heads, _, line = of("error_m: trials for a standard error")
    assert line[:2] == ["shrunk", "sigma_m 4, shrunk.factor 1, shrunk.kind median"]
    number = lambda text: float(text.replace("\xa0", ""))
    assert number(line[3]) == pytest.approx(spread, rel=6e-3)
    assert number(line[5]) == np.ceil((spread / (0.01 * mean[cell])) ** 2)
    wanted = float(heads[6].removeprefix("for\n"))  # half of the error that it has, in two digits
    assert wanted == pytest.approx(errors.values.max() / 2, rel=0.05)
    assert number(line[6]) == pytest.approx((spread / wanted) ** 2, rel=0.01)
    lines = of("error_m: trials until the paired difference from mean")[1:]
    assert len(lines) == 12
    for _, _, difference, away, trials, _ in lines:
        value, error = (float(x) for x in difference.split(" ± "))
        if error > 0 and trials != "enough":
            assert number(away) < 2
            assert number(trials) == pytest.approx(40 * (2 * error / value) ** 2, rel=0.1)
        elif error > 0:
            assert number(away) >= 2


def test_the_wanted_error_is_the_one_that_the_study_stops_at(tmp_path):
    until = 'until = { metric = "error_m", se = 0.07125 }'
    text = FILE.replace("micro_batch = 4", f"micro_batch = 4\n{until}")
    run.run_study(read_design(written(tmp_path, text)), tmp_path / "until")
    page = page_of(run.status_of(tmp_path / "until"), tmp_path / "until")
    table = next(t for t in page.tables if t["caption"].startswith("error_m: trials for"))
    assert "0.07125 is what the study asks for" in table["caption"]
    assert table["rows"][0][6] == "for\n0.07125"
    assert "or until the standard errors of error_m are 0.0712" in page.text


def timed(ran, folder, times):
    """Copy the study and give its chunks these times."""
    shutil.copytree(ran / "whole", folder)
    for number, time in enumerate(times):
        os.utime(folder / "commits" / f"{number:08d}.json", (time, time))
    return run.status_of(folder)


def test_the_speed_is_that_of_chunks_one_after_the_other_nights_left_out(ran, tmp_path):
    night = 40000.0
    outcome = timed(ran, tmp_path / "a", [1e9, 1e9 + 2, 1e9 + 4, night + 1e9, night + 1e9 + 2])
    assert report_runs.rate_of(outcome.store) == pytest.approx(4.0)  # eight trials in two seconds
    page = page_of(outcome, tmp_path / "a")
    assert "4 trials a second" in page.text
    assert "2001-09-09 01:46:40 UTC" in page.text
    copied = timed(ran, tmp_path / "b", [1e9] * 5)
    assert report_runs.rate_of(copied.store) is None
    assert "trials a second" not in page_of(copied, tmp_path / "b").text


def test_the_page_tells_how_it_was_made_and_how_to_make_it_again(whole, ran):
    text = page_of(whole, ran / "whole").text
    about = whole.store.attributes["about"]
    for name in ("jaxtrack", "jax", "jaxlib", "numpy"):
        assert f"{name} {about[name]}" in text
    assert "float64" in text
    again = "JAX_ENABLE_X64=1 "
    flags = whole.store.attributes["made_with"]["xla_flags"]
    again += f"XLA_FLAGS='{flags}' " if flags else ""
    assert f"{again}jaxtrack study run whole.toml --out another_folder" in text
    assert (
        f"scene, method.mean, method.shrunk, metric.error_m, metric.beyond), which stood in {ran}"
        in text
    )


def test_a_folder_that_cannot_be_written_is_one_line(ran, tmp_path, capsys):
    folder = shutil.copytree(ran / "whole", tmp_path / "whole")
    (folder / study_report.FILE).mkdir()
    assert main(["study", "report", str(folder)]) == 2
    assert len(capsys.readouterr().err.splitlines()) == 1


def test_times_of_chunks_are_those_of_their_records(ran):
    store = chunk_store.open_chunks(ran / "part")
    assert set(chunks.commit_times(store)) == {0, 1}
    file = pathlib.Path(ran / "part" / "commits" / "00000001.json")
    assert chunks.commit_times(store)[1] == file.stat().st_mtime


def test_long_tables_are_opened_by_a_click():
    rows = [[str(n), "1"] for n in range(41)]
    few, many = (
        folded("Means", table("t", "Means", ["", "x"], rows[:n], fields=1), n) for n in (40, 41)
    )
    assert "<details" not in few
    assert many.startswith('<details class="long"><summary>Means: 41 rows (printed if open)<')
    assert many.count("<tr") == 42
