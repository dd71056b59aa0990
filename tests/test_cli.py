"""The command line: good files, broken files, wrong options, and what it prints."""

import csv
import math
import pathlib
import subprocess
import sys
import types
from typing import NamedTuple

import numpy as np
import pytest

import jaxtrack
from jaxtrack.cli import main
from jaxtrack.cli.screen import console_of_tables

EXAMPLE = pathlib.Path(__file__).parents[1] / "notebooks" / "radar_example.csv"
LAST_DOTS = np.array([[-7248.0, 26643.0], [-17794.0, 14169.0], [-16459.0, 28155.0]])
QUICK = ("--sigma-m", "50", "--false-per-run", "0.5")


@pytest.fixture
def run(tmp_path, monkeypatch, capsys):
    """Return a runner `run(*arguments) -> (exit code, stdout, stderr)` in an empty folder."""
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("COLUMNS", "120")

    def run(*arguments: str) -> tuple[int, str, str]:
        code = main([str(argument) for argument in arguments])
        out, err = capsys.readouterr()
        assert "Traceback" not in out + err
        return code, out, err

    return run


def rows_of(path: str) -> list[dict[str, str]]:
    with open(path, newline="") as file:
        return list(csv.DictReader(file))


def test_initiate_writes_tracks_table_and_figure(run):
    code, out, err = run("initiate", EXAMPLE, *QUICK, "--figure", "tracks.png")
    assert (code, err) == (0, "")
    rows = rows_of("tracks.csv")
    assert len(rows) >= 3
    found = np.array([[float(row["x_m"]), float(row["y_m"])] for row in rows])
    away = np.linalg.norm(found[:, None] - LAST_DOTS[None], axis=-1)
    assert (away.min(axis=0) < 150.0).all()
    # The three targets have the highest scores, and all of them move at 280 m/s.
    for row in rows[:3]:
        speed = math.hypot(float(row["vx_m_s"]), float(row["vy_m_s"]))
        assert 270.0 < speed < 290.0
        assert float(row["time_s"]) == 1_700_000_060.0
        assert row["stage"] == "tentative"
    assert "gate " in out
    assert "20 scenes without targets" in out
    for heading in ("x, m", "y, m", "speed, m/s", "course, °", "sigma, m", "score", "looks"):
        assert heading in out
    assert "281." in out
    figure = pathlib.Path("tracks.png").read_bytes()
    assert figure.startswith(b"\x89PNG")
    assert len(figure) > 20_000


TWO = """time_s,x_m,y_m
"""
for _t in range(12):
    TWO += f"{_t + 100},{30 * _t + 3 * (_t % 2)},{500 - 20 * _t}\n"
    TWO += f"{_t + 100},{400 - 9 * _t},{35 * _t}\n"
    TWO += f"{_t + 100},{(67 * _t) % 400},{(331 * _t) % 500}\n"


def test_track_writes_a_row_for_each_track_and_look_and_a_figure(run):
    pathlib.Path("two.csv").write_text(TWO)
    options = ("--speed-max-m-s", "60", "--tracker", "optimal", "--p-detect", "0.95")
    code, out, err = run("track", "two.csv", *options, "--max-tracks", "20", "--figure", "a.png")
    assert (code, err) == (0, "")
    rows = rows_of("tracks.csv")
    last = [row for row in rows if float(row["time_s"]) == 111.0]
    found = sorted((float(row["x_m"]), float(row["y_m"])) for row in last)
    np.testing.assert_allclose(found, [(301.0, 385.0), (332.0, 280.0)], atol=8.0)
    assert {row["stage"] for row in last} == {"confirmed"}
    assert len({row["identity"] for row in rows}) == 2
    for word in ("nats confirm a track", "from, s", "looks", "speed,"):
        assert word in out
    assert pathlib.Path("a.png").read_bytes().startswith(b"\x89PNG")


def test_a_sonars_beams_are_read_followed_and_drawn(run):
    rows = ["time_s,beam,range_m,heading_deg,x_m,y_m"]
    for look in range(10):
        # A target that stands 60 m ahead of a vehicle under way, on the edge of two beams.
        rows.append(f"{0.5 * look},{15 + look % 2},{60 - 0.5 * look},0,{500000 + 0.5 * look},0")
        rows.append(f"{0.5 * look},{3 * look % 29},{20 + 11 * look},0,{500000 + 0.5 * look},0")
    pathlib.Path("beams.csv").write_text("\n".join(rows))
    options = ("--beams", "32", "--speed-max-m-s", "4", "--p-detect", "0.95", "--sigma-m", "2")
    code, out, _ = run("track", "beams.csv", *options, "--tracker", "greedy", "--figure", "b.svg")
    assert code == 0
    last = [row for row in rows_of("tracks.csv") if float(row["time_s"]) == 4.5]
    assert abs(float(last[0]["north_m"]) - 500060.0) < 6.0
    assert "500060" in out or "50005" in out or "50006" in out
    assert pathlib.Path("b.svg").read_text().startswith("<?xml")
    code, _, err = run("estimate", "beams.csv", *options, "--method", "sht", "--figure", "b.csv")
    assert (code, "want a name that ends in" in err) == (2, True)


def test_beams_read_as_detections_are_told_of_the_option(run):
    pathlib.Path("b.csv").write_text("time_s,beam,range_m,heading_deg,x_m,y_m\n0,1,60,0,0,0\n")
    code, _, err = run("estimate", "b.csv", "--speed-max-m-s", "4")
    assert (code, "column 'beam'" in err, "--beams" in err) == (2, True, True)


def test_one_file_is_not_written_over_another(run):
    wrong = ("--out", "a.png", "--figure", "a.png")
    code, _, err = run("track", EXAMPLE, "--speed-max-m-s", "9", *wrong)
    assert (code, "--figure: got a.png, which is another" in err) == (2, True)


def test_estimate_prints_where_targets_were_are_and_go(run):
    pathlib.Path("two.csv").write_text(TWO)
    code, out, err = run("estimate", "two.csv", "--speed-max-m-s", "60", "--method", "sht")
    assert code == 0
    assert not err or err.startswith("note: ")
    assert rows_of("motion_elements.csv")
    assert "first" in out
    assert "v x," in out


@pytest.mark.parametrize(
    ("arguments", "word"),
    [
        (("track", EXAMPLE), "speed-max-m-s"),
        (("track", EXAMPLE, "--speed-max-m-s", "-1"), "v_max_m_s: got -1"),
        (("track", "no.csv", "--speed-max-m-s", "9"), "no.csv: No such file"),
        (("track", EXAMPLE, "--speed-max-m-s", "9", "--out", EXAMPLE), "the file of detections"),
        (("track", EXAMPLE, "--speed-max-m-s", "9", "--figure", "a.txt"), "--figure: got a.txt"),
        (("track", EXAMPLE, "--speed-max-m-s", "9", "--seed", "-1"), "--seed: got -1"),
        (("track", EXAMPLE, "--speed-max-m-s", "9", "--echoes", "0.5"), "echoes: got 0.5"),
        (("estimate", EXAMPLE, "--speed-max-m-s", "9", "--sigma-m", "0"), "sigma_m: got 0"),
        (("estimate", EXAMPLE, "--speed-max-m-s", "9", "--beams", "9"), "column"),
        (
            ("track", EXAMPLE, "--speed-max-m-s", "9", "--beams", "9", "--sector-deg", "0"),
            "--sector-deg: got 0",
        ),
    ],
)
def test_wrong_options_of_track_and_estimate_are_one_line(run, arguments, word):
    code, out, err = run(*arguments)
    assert code == 2
    assert word in out + err


@pytest.mark.slow
def test_exactly_three_tracks_at_a_rare_false_track(run):
    code, _, _ = run("initiate", EXAMPLE, "--sigma-m", "50", "--false-per-run", "0.05")
    assert code == 0
    assert len(rows_of("tracks.csv")) == 3


def test_byte_order_mark_line_ends_and_semicolons_change_nothing(run):
    assert run("initiate", EXAMPLE, *QUICK)[0] == 0
    plain = pathlib.Path("tracks.csv").read_bytes()
    text = EXAMPLE.read_text().replace(",", ";").replace("\n", "\r\n")
    pathlib.Path("windows.csv").write_bytes(b"\xef\xbb\xbf" + text.encode())
    assert run("initiate", "windows.csv", *QUICK)[0] == 0
    assert pathlib.Path("tracks.csv").read_bytes() == plain


@pytest.mark.slow
def test_polar_file_far_from_zero_keeps_compass_axes(run):
    lines = ["time_s,range_m,bearing_deg,own_x_m,own_y_m"]
    for k in range(6):  # due east at 200 m/s, 1 km north of a ship at a UTM position
        east = 200.0 * 2 * k
        bearing = math.degrees(math.atan2(east, 1000.0))
        lines.append(f"{2 * k},{math.hypot(east, 1000.0):.3f},{bearing:.6f},5934000,565000")
    pathlib.Path("polar.csv").write_text("\n".join(lines))
    code, out, _ = run("initiate", "polar.csv", "--false-per-run", "1", "--figure", "t.png")
    assert code == 0
    row = rows_of("tracks.csv")[0]
    assert float(row["north_m"]) == pytest.approx(5935000.0, abs=5.0)
    assert float(row["east_m"]) == pytest.approx(567000.0, abs=5.0)
    assert "north, m" in out
    assert " 90.0 " in out


@pytest.mark.parametrize(
    ("text", "why"),
    [
        ("time_s,x_m,y_m\n5,1,2\n", "one look starts no track"),
        ("time_s,x_m,y_m\n0,,\n2,,\n", "there are no detections"),
    ],
)
def test_one_look_or_no_detection_is_an_empty_table(run, text, why):
    pathlib.Path("few.csv").write_text(text)
    code, out, err = run("initiate", "few.csv", "--figure", "few.png")
    assert code == 0
    assert "no tracks" in out
    assert err == f"note: {why}\n"
    assert pathlib.Path("tracks.csv").read_text().startswith("time_s,identity,stage,x_m,y_m")
    assert rows_of("tracks.csv") == []
    assert pathlib.Path("few.png").stat().st_size > 2000


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("", "empty file"),
        ("time_s,x_m,y_m\n", "no rows"),
        ("time_s,x_m\n0,1\n", "want column y_m"),
        ("time_s,x_m,y_m\n0,nan,2\n", "row 2, column x_m: got nan"),
        ("time_s,x_m,y_m\n0,one,2\n", "row 2, column x_m: got 'one'"),
        ("time_s,x_m,y_m\n2,1,2\n1,1,2\n", "row 3, column time_s: got 1 after 2"),
        ("time_s,x_m,y_m,sigma_m\n0,1,2,-3\n", "column sigma_m: got -3"),
        ("time_s,x_m,y_m,wieght\n0,1,2,1\n", "unknown column"),
        ("time_s,x_m,y_m\n0,1\n", "got 2 cells"),
    ],
)
def test_broken_files_are_one_clear_line(run, text, message):
    pathlib.Path("broken.csv").write_text(text)
    code, out, err = run("initiate", "broken.csv")
    assert (code, out) == (2, "")
    assert err.startswith("jaxtrack: broken.csv")
    assert err.count("\n") == 1
    assert message in err
    assert not pathlib.Path("tracks.csv").exists()


@pytest.mark.parametrize(
    ("options", "message"),
    [
        (("--sigma-m", "-5"), "sigma_m: got -5"),
        (("--sigma-m", "nan"), "sigma_m: got nan"),
        (("--speed-min-m-s", "500"), "speed_max_m_s: got 400, want more than speed_min_m_s, 500"),
        (("--false-per-run", "0"), "false_per_run: got 0"),
        (("--false-per-run", "-1"), "false_per_run: got -1"),
        (("--p-detect", "1.5"), "p_detect: got 1.5"),
        (("--max-tracks", "0"), "max_tracks: got 0"),
        (("--seed", "-1"), "seed: got -1"),
        (("--figure", "tracks.doc"), "--figure: got tracks.doc"),
        (("--out", "no/such/tracks.csv"), "there is no folder"),
        (("--out", "."), "."),
    ],
)
def test_wrong_options_are_one_clear_line(run, options, message):
    # A single look costs no computation; the options are checked all the same.
    pathlib.Path("one.csv").write_text("time_s,x_m,y_m\n5,1,2\n")
    code, out, err = run("initiate", "one.csv", *options)
    assert (code, out) == (2, "")
    assert err.startswith("jaxtrack: ")
    assert err.count("\n") == 1
    assert message in err


def test_missing_file_and_folder_in_place_of_a_file(run, tmp_path):
    for name in ("nope.csv", str(tmp_path)):
        code, _, err = run("initiate", name)
        assert code == 2
        assert err.startswith(f"jaxtrack: {name}: ")


@pytest.mark.parametrize(
    "arguments",
    [
        (),
        ("dance",),
        ("initiate",),
        ("initiate", "x.csv", "--method", "magic"),
        ("initiate", "a", "b"),
    ],
)
def test_wrong_commands_exit_with_two(run, arguments):
    code, _, err = run(*arguments)
    assert code == 2
    assert err.strip()


def test_help_tells_units(run):
    code, out, _ = run("initiate", "--help")
    assert code == 0
    for words in ("m/s", "standard deviation", "--false-per-run", "--bearing"):
        assert words in out


class FakeContext(NamedTuple):
    out: pathlib.Path
    trials: int
    seed: int
    console: object
    progress: object


class FakeStudy(NamedTuple):
    name: str
    title: str
    source: str
    trials_short: int
    trials_full: int
    seconds_short: float
    seconds_full: float
    run: object


@pytest.fixture
def studies(monkeypatch):
    """Put two small studies in the place of the real ones; return the contexts they saw."""
    seen = []

    def work(context):
        context.progress("scenes", 1, 2)
        context.console.print("a table")
        (context.out / "table.txt").write_text("1")
        seen.append(context)

    def interrupted(context):
        raise KeyboardInterrupt

    module = types.ModuleType("jaxtrack.studies")
    module.__path__ = [str(pathlib.Path(jaxtrack.__file__).parent / "studies")]
    good = FakeStudy("nht", "Track initiation", "A paper", 50, 5000, 9.0, 540.0, work)
    bad = good._replace(name="stop", run=interrupted)
    module.STUDIES = {"nht": good, "stop": bad}  # pyright: ignore
    module.Context = FakeContext  # pyright: ignore
    monkeypatch.setitem(sys.modules, "jaxtrack.studies", module)
    return seen


def test_list_tells_trials_and_seconds(run, studies):
    code, out, _ = run("list")
    assert code == 0
    line = next(line for line in out.splitlines() if line.startswith("nht"))
    for cell in ("Track initiation", "50", "5,000", "9", "540"):
        assert cell in line
    assert "A paper" in out


def test_reproduce_gives_each_study_its_folder_seed_and_trials(run, studies):
    code, out, err = run("reproduce", "nht", "--seed", "7")
    assert (code, err) == (0, "")
    assert (studies[0].trials, studies[0].seed) == (50, 7)
    assert pathlib.Path("results/nht/table.txt").read_text() == "1"
    for words in ("seed 7", "jaxtrack ", "jax ", "numpy ", "Python ", "device", "a table"):
        assert words in out
    assert out.splitlines()[-1].startswith("results/report.html (")
    assert "a table" in pathlib.Path("results/report.html").read_text()
    assert run("reproduce", "nht", "--trials", "3", "--out", "elsewhere")[0] == 0
    assert (studies[1].trials, studies[1].out) == (3, pathlib.Path("elsewhere/nht"))


def test_tables_in_a_file_are_whole_and_keep_a_stated_width(monkeypatch):
    monkeypatch.delenv("COLUMNS", raising=False)
    assert console_of_tables().width == 220
    monkeypatch.setenv("COLUMNS", "70")
    assert console_of_tables().width == 70


def test_reproduce_full_says_how_long_it_takes(run, studies):
    code, out, _ = run("reproduce", "nht", "--full")
    assert code == 0
    assert studies[0].trials == 5000
    assert "9 minutes" in out


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (("magic",), "there is no study magic; there are: nht, stop"),
        (("nht", "--trials", "0"), "--trials: got 0"),
        (("nht", "--trials", "5", "--full"), "want one of them"),
        (("nht", "--seed", "-1"), "--seed: got -1"),
        (("nht", "--out", "taken"), "taken"),
    ],
)
def test_reproduce_rejects(run, studies, arguments, message):
    pathlib.Path("taken").write_text("a file, not a folder")
    code, _, err = run("reproduce", *arguments)
    assert code == 2
    assert err.startswith("jaxtrack: ")
    assert message in err
    assert studies == []


def test_reproduce_leaves_a_study_of_a_file_alone(run, studies):
    kept = pathlib.Path("results/nht/commits")
    kept.mkdir(parents=True)
    code, _, err = run("reproduce", "nht")
    assert (code, studies) == (2, [])
    assert "results/nht: holds a study that `jaxtrack study` keeps" in err
    assert kept.exists()


def test_an_interrupt_ends_with_130(run, studies):
    code, _, err = run("reproduce")
    assert code == 130
    assert len(studies) == 1  # the study before it is kept
    assert "a table" in pathlib.Path("results/report.html").read_text()
    assert err == "jaxtrack: interrupted\n"


@pytest.mark.parametrize("package", ["tyro", "rich", "matplotlib"])
def test_a_missing_extra_is_one_line(run, monkeypatch, package):
    for name in [name for name in sys.modules if name.partition(".")[0] == package]:
        monkeypatch.delitem(sys.modules, name)
    for name in [name for name in sys.modules if name.startswith("jaxtrack.plots")]:
        monkeypatch.delitem(sys.modules, name)
    monkeypatch.delattr("jaxtrack.plots", raising=False)
    monkeypatch.setitem(sys.modules, package, None)
    code, _, err = run("initiate", EXAMPLE, "--figure", "tracks.png")
    assert code == 2
    assert err.count("\n") == 1
    assert "pip install 'jaxtrack[studies,plots]'" in err


def test_the_input_is_not_overwritten_and_folders_are_no_files(run, tmp_path):
    file = tmp_path / "detections.csv"
    file.write_text(EXAMPLE.read_text())
    before = file.read_bytes()
    code, _, err = run("initiate", file, "--out", file)
    assert code != 0
    assert "the file of detections itself" in err
    assert file.read_bytes() == before
    for option in ("--out", "--figure"):
        folder = tmp_path / "folder.png"
        folder.mkdir(exist_ok=True)
        code, _, err = run("initiate", file, option, folder)
        assert code != 0
        assert "want the name of a file" in err


@pytest.mark.slow
def test_the_process_uses_every_core_and_float32(tmp_path):
    program = (
        "import os, sys, jax\n"
        "from jaxtrack.cli import main\n"
        "code = main(sys.argv[1:])\n"
        "assert len(jax.devices()) == len(os.sched_getaffinity(0))\n"
        "assert not jax.config.jax_enable_x64\n"
        "sys.exit(code)\n"
    )
    arguments = ["initiate", EXAMPLE, *QUICK, "--out", tmp_path / "tracks.csv"]
    done = subprocess.run(
        [sys.executable, "-W", "error", "-c", program, *map(str, arguments)],
        capture_output=True,
        text=True,
        timeout=300,
    )
    assert (done.returncode, done.stderr) == (0, "")
    assert len(rows_of(str(tmp_path / "tracks.csv"))) >= 3
