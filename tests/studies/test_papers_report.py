"""The report of the papers' studies: tables as they went to the console, marks, figures."""

import io
import json
import pathlib
import re

import numpy as np
import pytest
import xarray as xr
from rich.console import Console

from jaxtrack import plots, studies
from jaxtrack.cli import main
from jaxtrack.studies import Study, parts, shown, store, tables
from jaxtrack.studies.report import papers
from jaxtrack.studies.tables import Mark, Row
from tests.studies.reading import checked

ROWS = [
    Row("joint, situation I", tables.rate(197, 200), "good", Mark(0.97)),
    Row("HT, situation I", tables.rate(2, 200), "poor", Mark(0.97)),
    Row("√(card² + loc²)", tables.mean(2.0, 0.1, 200, "m"), "2.01", Mark(2.01, at_least=False)),
    Row("IHT <b>", tables.rate(2, 200), "serious"),
    Row("few", tables.rate(3, 4), "", Mark(0.98)),
    Row("nothing", tables.mean(np.nan, np.nan, 200), "", Mark(0.98)),
]

CELLS = [["1.00/2\n3 m"]]


def work(context):
    say = context.console.print
    say(
        tables.grid_table("Found [bold]a run[/]", ["HT"], ["I & II"], [["1.00/2\n3 m"]], trials=200)
    )
    wide = [f"{column}: mean OSPA" for column in range(16)]
    say(tables.grid_table("Wide", ["joint"], wide, [["19.25 ± .25 m"] * 16], trials=200))
    say(tables.marks_table("Marks, fixed beforehand", ROWS[:4]))
    say(tables.failed_table("All marks", ROWS))
    say("Optuna is not installed.")
    summary = {"marks": [tables.entry(row) for row in ROWS]}
    store.save(context.out, {"a": xr.Dataset({"x": ("t", np.arange(3))})}, summary)
    panels = {"Noise": {"joint": (np.arange(3.0), np.ones(3), np.ones(3))}}
    figure = plots.error_curves(panels, x_label="σ, m", y_label="OSPA, m", title="Errors by noise")
    plots.save(figure, context.out / "figure_16_velocity_ospa_clutter_in_missed_beams.png")


NHT = Study("nht", "Track initiation", "A paper", 50, 5000, 9.0, 540.0, work)
CCM = NHT._replace(name="ccm", title="Two targets that meet", run=lambda c: c.console.print("none"))


def reproduced(out: pathlib.Path) -> None:
    """Run two small studies, one command each, into a folder."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(studies, "STUDIES", {"nht": NHT, "ccm": CCM})
        patch.setenv("COLUMNS", "200")
        assert main(["reproduce", "nht", "--seed", "7", "--out", str(out)]) == 0
        assert main(["reproduce", "ccm", "--out", str(out)]) == 0


@pytest.fixture(scope="module")
def out(tmp_path_factory):
    out = tmp_path_factory.mktemp("results")
    reproduced(out)
    return out


@pytest.fixture(scope="module")
def page(out):
    return checked((out / papers.FILE).read_text())


def test_the_command_ends_with_the_page_and_its_size(tmp_path, capsys):
    reproduced(tmp_path)
    last = capsys.readouterr().out.splitlines()[-1]
    assert re.fullmatch(rf"{re.escape(str(tmp_path))}/report\.html \(\d+ kB\)", last)


def test_the_page_has_all_studies_of_the_folder_also_those_of_earlier_commands(page):
    titles = [heading for level, heading in page.headings if level == 2]
    assert titles == ["Studies and marks", "nht", "ccm"]
    heads, nht, ccm = page.tables[0]["rows"]
    assert heads[4:7] == ["reached", "missed", "smoke"]
    assert nht[:3] == ["nht", "Track initiation", "50"]
    assert nht[4:7] == ["2", "2", "1"]
    assert ccm[4:7] == ["0", "0", "0"]
    for words in ("A paper", "7", "in full 5000", "jaxtrack reproduce nht --trials 50 --seed 7"):
        assert words in page.text


def test_a_resumed_study_tells_the_time_of_its_last_session(page, tmp_path):
    assert "since it was resumed" not in page.text
    (tmp_path / "nht" / parts.FOLDER).mkdir(parents=True)
    reproduced(tmp_path)
    text = checked((tmp_path / papers.FILE).read_text()).text
    assert len(re.findall(r"\d s since it was resumed, compilation included; ended", text)) == 1
    assert len(re.findall(r"\d s, compilation included; ended", text)) == 1  # the other one


def test_tables_are_those_of_the_console(page):
    of = lambda caption: next(t["rows"] for t in page.tables if t["caption"].startswith(caption))
    assert of("Found a run, 200 trials") == [["", "I & II"], ["HT", "1.00/2\n3 m"]]
    marks = of("Marks, fixed beforehand")
    assert marks[0] == ["", "ours", "95 %", "trials", "paper", "mark", "verdict"]
    assert [row[-1] for row in marks[1:]] == ["pass", "fails", "pass", ""]
    assert marks[4][0] == "IHT <b>"
    assert marks[3][1:3] == ["2 m", "1.8 … 2.2"]
    assert len(of("All marks: 2 of 5 pass, 1 smoke")) == 1 + 2
    assert "Optuna is not installed." in page.text


def test_marks_missed_and_reached_come_first_with_links_to_their_rows(page, out):
    missed = page.tables[1]
    assert missed["caption"] == "Marks missed: 2"
    assert [row[0] for row in missed["rows"][1:]] == ["HT, situation I", "nothing"]
    ours = missed["rows"][1][2:]
    assert ours == [".010", ".003 … .036", "≥ 0.97", "poor"]
    assert missed["rows"][2][2] == "–"
    assert page.tables[2]["caption"] == "Marks reached: 2"
    links = [a["href"] for tag, a in page.tags if tag == "a" and "table" in a["href"]]
    # HT, nothing; joint, √: found in the table of all marks or in that of the missed ones.
    assert links == ["#nht-table-3-1", "#nht-table-4-1", "#nht-table-3-0", "#nht-table-3-2"]


def test_figures_are_inside_with_what_they_show_in_words(page, out):
    (image,) = [a for tag, a in page.tags if tag == "img"]
    assert (
        image["alt"]
        == "Errors by noise. Noise: OSPA, m mean ± 2 standard errors over σ, m. Shown: joint."
    )
    assert "Errors by noise (figure_16_velocity_ospa_clutter_in_missed_beams.png)" in page.text


def test_a_figure_without_words_is_told_by_its_name(out, tmp_path):
    (tmp_path / "nht").mkdir()
    for name in (shown.FILE, store.SUMMARY):
        (tmp_path / "nht" / name).write_bytes((out / "nht" / name).read_bytes())
    (tmp_path / "nht" / "figure_07_votes.png").write_bytes(b"\x89PNG\r\n\x1a\n")
    (found,) = papers.found_in(tmp_path, {"nht": NHT, "ccm": CCM})
    page = checked(papers.page_of([found]))
    assert [a["alt"] for tag, a in page.tags if tag == "img"] == ["figure 07 votes"]


def test_what_is_printed_is_kept_and_printed_all_the_same():
    screen = io.StringIO()
    console = Console(file=screen, width=120)
    console.print("before")
    with shown.recorded(console) as seen:
        console.print("a line")
        console.print(tables.marks_table("Marks", ROWS))
    console.print("after")
    line, table = shown.plain(seen)
    assert line == "a line"
    assert table["title"] == "Marks"
    assert [row[0] for row in table["rows"]] == [row.what for row in ROWS]
    text = screen.getvalue()
    assert all(word in text for word in ("before", "a line", "joint, situation I", "after"))


def test_a_folder_of_an_older_version_is_left_out(tmp_path):
    (tmp_path / "nht").mkdir()
    (tmp_path / "nht" / store.SUMMARY).write_text(json.dumps({"marks": []}))
    assert papers.found_in(tmp_path, {"nht": NHT}) == []
