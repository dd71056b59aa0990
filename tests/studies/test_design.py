"""A study's file: what it may say, and that errors tell line and key."""

import pathlib

import pytest

from jaxtrack.studies.design import axes_of, read_design
from jaxtrack.studies.study_file import StudyError, line_of
from tests.studies.own_study import BESIDE, FILE, FUNCTIONS, written


def test_a_file_is_tied_to_functions_beside_it(tmp_path):
    design = read_design(written(tmp_path))
    assert design.scene.call.__name__ == "points"
    assert design.scene.fields == {"count": 5}
    assert design.scene.grid == {"sigma_m": (1.0, 4)}
    assert design.scene.static == {"count"}
    assert [method.name for method in design.methods] == ["mean", "shrunk"]
    assert design.methods[1].static == {"kind"}  # text cannot be traced
    assert list(axes_of(design, design.methods[1])) == ["sigma_m", "shrunk.factor", "shrunk.kind"]
    assert (design.seed, design.trials, design.chunk, design.micro_batch) == (3, 40, 8, 4)
    assert design.until is None


def test_what_is_not_said_has_a_default(tmp_path):
    text = FILE.replace("seed = 3\n", "").replace("chunk = 8\nmicro_batch = 4\n", "")
    design = read_design(written(tmp_path, text))
    assert (design.seed, design.chunk, design.micro_batch) == (0, 256, 32)
    assert design.config["chunk"] == 256


def test_folders_with_files_of_one_name_do_not_mix(tmp_path):
    first = read_design(written(tmp_path / "a"))
    changed = FUNCTIONS.replace("sigma_m * jax", "2 * sigma_m * jax")
    second = read_design(written(tmp_path / "b", functions=changed))
    assert first.scene.call.__code__.co_filename == str(tmp_path / "a" / "mine.py")
    assert second.scene.call.__code__.co_filename == str(tmp_path / "b" / "mine.py")


def test_lines_are_those_of_the_file():
    text = "a = 1\n\n# b\n[t]\nb = [\n 1,\n 2]\nc = { d = 3 }\n[t.u]\ne = 1\n"
    lines = {("a",): 1, ("t",): 4, ("t", "b"): 5, ("t", "c", "d"): 8, ("t", "u", "e"): 10}
    for path, line in lines.items():
        assert line_of(text, path) == line
    assert line_of(text, ("t", "u", "missing")) == 9
    assert line_of(text, ("missing",)) == 1


KIND = "19: method.shrunk.kind: got a grid, but a metric has this name"
WRONG = [
    ("trials = 40", "trials = 0", "3: trials: got 0, want a whole number from 1"),
    ("trials = 40", 'trials = "40"', "3: trials: got '40', want a whole number"),
    ("trials = 40", "", "1: trials: is missing"),
    ("trials = 40", "trials = ", "Invalid value (at line 3"),
    ("seed = 3", "seed = -1", "2: seed: got -1"),
    ("seed = 3", "sed = 3", "2: sed: unknown key, want one of seed, trials"),
    ("chunk = 8", "chunk = 6", "4: chunk: got 6, want chunk (6) a multiple of micro_batch (4)"),
    ("sigma_m = {", "sigma = {", "9: scene.sigma: unknown field; the function is points(key, *,"),
    ("count = 5", "", "scene.static: got ['count'], want a list of names of fields"),
    ("count = 5", "count = nan", "10: scene.count: got nan, want a number"),
    ("count = 5", "count = 1979-05-27", "10: scene.count: got datetime.date"),
    ("count = 5", "count = ['a']", "10: scene.count: got ['a'], want numbers in a list"),
    ("[1.0, 4]", "[]", "9: scene.sigma_m: got {'grid': []}, want { grid = [value, …] }"),
    ("[1.0, 4]", "[1.0, 1]", "9: scene.sigma_m: got [1.0, 1], want different values of one kind"),
    ("[1.0, 4]", "[1.0, 'a']", "9: scene.sigma_m: got [1.0, 'a'], want different values"),
    ("{ grid = [1.0, 4] }", "{ gird = [1] }", "9: scene.sigma_m: got {'gird': [1]}"),
    ("limit_m = 0.5", "", "metric.beyond: missing a required argument: 'limit_m'; the function"),
    ("limit_m = 0.5", "limit_m = { grid = [1, 2] }", "metric.beyond.limit_m: got a grid"),
    ("factor =", "beyond =", "unknown field; the function is shrunk(points, *, factor"),
    ('["mean", "median"] }', '["a", "b"] }\n[metric.kind]\nfunction = "mine:error_m"', KIND),
    ("mine:mean", "mine:men", "14: method.mean.function: got 'mine:men', but mine has no function"),
    ("mine:mean", "yours:mean", "14: method.mean.function: No module named 'yours'"),
    ("mine:mean", "mean", "14: method.mean.function: got 'mean', want one of standard, modified"),
    ("mine:mean", ":mean", "14: method.mean.function: got '', want the name of a module"),
    ("[method.mean]", '[method."a b"]', "method.a b: want a name of letters"),
    ("seed = 3", "until = { metric = 'eror', se = 1 }", "2: until.metric: got 'eror', want one of"),
    ("seed = 3", "until = { metric = 'error_m', se = 0 }", "2: until.se: got 0, want a positive"),
    ("seed = 3", "until = { metric = 'error_m' }", "2: until: got metric, want metric and se"),
]


@pytest.mark.parametrize(("old", "new", "message"), WRONG)
def test_errors_tell_line_and_key(tmp_path, old, new, message):
    file = written(tmp_path, FILE.replace(old, new, 1))
    with pytest.raises(StudyError) as error:
        read_design(file)
    assert str(error.value).startswith(str(file))
    assert message in str(error.value)
    assert "\n" not in str(error.value)


def test_a_function_file_that_does_not_import_is_the_study_files_error(tmp_path):
    file = written(tmp_path, functions="import nowhere\n")
    with pytest.raises(StudyError, match=r"scene.function: .*ModuleNotFoundError.*nowhere"):
        read_design(file)
    assert BESIDE in (tmp_path / "beside.py").read_text()


def test_a_file_that_is_no_text(tmp_path):
    file = tmp_path / "study.toml"
    file.write_bytes(b"\xff\xfe\x00")
    with pytest.raises(StudyError, match="is not text in UTF-8"):
        read_design(file)
    with pytest.raises(OSError, match="No such file"):
        read_design(pathlib.Path("nowhere.toml"))
