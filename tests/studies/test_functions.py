"""Functions of one's own: what they import is seen, changed files are read anew and are told."""

import pytest

from jaxtrack.studies.design import read_design
from jaxtrack.studies.functions import files_of, find_function
from jaxtrack.studies.made import decisive
from jaxtrack.studies.run import open_study, run_study
from jaxtrack.studies.study_file import StudyError
from tests.studies.own_study import BESIDE, FILE, written

TREE = {
    "mine.py": "import numpy, gone\nfrom pack import one\nimport deep.er.two, beside\n",
    "pack/__init__.py": "from .three import *\n",
    "pack/one.py": "from ..outside import x\nfrom . import four\n",
    "pack/three.py": "def f():\n    import late\n",
    "pack/four.py": "from .sub.five import y\n",
    "pack/sub/five.py": "",  # of a package without __init__.py
    "deep/er/two.py": "def (\n",  # is Python's to complain of
    "late.py": "import mine\n",
    "beside.py": "x = 1\n",
    "other.py": "y = 1\n",
}


def planted(folder, tree):
    for name, text in tree.items():
        (folder / name).parent.mkdir(parents=True, exist_ok=True)
        (folder / name).write_text(text)


def test_all_files_that_one_imports_are_found(tmp_path):
    planted(tmp_path / "study", TREE)
    (tmp_path / "outside.py").write_text("x = 1\n")
    found = files_of(tmp_path / "study" / "mine.py")
    names = {file.relative_to(tmp_path / "study").as_posix() for file in found}
    assert names == TREE.keys() - {"other.py"}
    assert len(set(found.values())) == len(TREE) - 1


def test_a_change_of_what_is_imported_is_refused_with_the_files_name(tmp_path):
    out = tmp_path / "out"
    written(tmp_path)
    planted(tmp_path, {"lib/deep.py": "one = 1\n", "beside.py": BESIDE + "from lib import deep\n"})
    assert run_study(read_design(tmp_path / "study.toml"), out).complete
    (tmp_path / "lib" / "deep.py").write_text("one = 2\n")
    refused = r"this study's trials, .*; what differs: made_with.functions.lib/deep.py: .* here$"
    with pytest.raises(StudyError, match=refused):
        run_study(open_study(out), out)
    (tmp_path / "lib" / "deep.py").write_text("one = 1\n")
    (tmp_path / "nobodys.py").write_text("two = 2\n")
    assert run_study(open_study(out), out).complete


def test_trials_go_under_the_code_that_computed_them(tmp_path):
    file = written(tmp_path)
    design = read_design(file)
    before = decisive(design)["functions"]
    (tmp_path / "beside.py").write_text("def absolute(x):\n    return 7.0\n")
    assert decisive(design)["functions"] == before
    assert decisive(read_design(file))["functions"] != before


def test_what_a_function_imports_when_it_is_called_is_found(tmp_path):
    file = written(tmp_path)
    late = BESIDE.replace("return", "import later\n\n    return later.one *")
    planted(tmp_path, {"beside.py": late, "later.py": "one = 1.0\n"})
    assert run_study(read_design(file), tmp_path / "out").complete


def test_an_import_from_above_the_folder_is_left_to_python(tmp_path):
    planted(tmp_path, {"mine.py": "from ................................ import x\n"})
    assert len(files_of(tmp_path / "mine.py")) == 1


def test_what_has_changed_beside_a_file_is_imported_anew(tmp_path):
    file = written(tmp_path)
    assert read_design(file).metrics[0].call(None, -2.0) == 2.0
    (tmp_path / "beside.py").write_text("def absolute(x):\n    return 7.0\n")
    assert read_design(file).metrics[0].call(None, -2.0) == 7.0


def test_files_of_one_name_beside_two_studies_do_not_mix(tmp_path):
    first, second = written(tmp_path / "a"), written(tmp_path / "b")
    (tmp_path / "b" / "beside.py").write_text("def absolute(x):\n    return 7.0\n")
    for file, wanted in ((first, 2.0), (second, 7.0), (first, 2.0)):
        assert read_design(file).metrics[0].call(None, -2.0) == wanted


def test_two_files_of_a_study_share_what_they_import(tmp_path):
    shared = "from kinds import Kind\n\n\ndef kind():\n    return Kind\n"
    planted(tmp_path, {"kinds.py": "class Kind:\n    pass\n", "a.py": shared, "b.py": shared})
    kinds = [find_function("scene", f"{name}:kind", tmp_path)() for name in "ab"]
    assert kinds[0] is kinds[1]


@pytest.mark.parametrize("how", ["raise SystemExit(1)", "1 / 0", "def (", "import nowhere"])
@pytest.mark.parametrize("beside", [True, False])
def test_a_module_that_does_not_import_is_the_study_files_error(tmp_path, monkeypatch, how, beside):
    home = tmp_path if beside else tmp_path / "elsewhere"
    planted(home, {"crooked.py": f"{how}\n"})
    monkeypatch.syspath_prepend(home)
    file = written(tmp_path, FILE.replace("mine:mean", "crooked:mean"))
    with pytest.raises(StudyError, match=r"study.toml:14: method.mean.function: ") as error:
        read_design(file)
    assert "\n" not in str(error.value)


def test_what_fails_while_it_runs_is_named_with_file_line_and_key(tmp_path):
    file = written(tmp_path, FILE.replace("mine:error_m", "mine:later"))
    wanted = r"study.toml:14: method.mean.function: fails in trials 0 to 7: .*RuntimeError: no luck"
    with pytest.raises(StudyError, match=wanted):
        run_study(read_design(file), tmp_path / "out")
    with pytest.raises(StudyError, match=r"out's study:14: method.mean.function: fails in trials"):
        run_study(open_study(tmp_path / "out"), tmp_path / "out")


def test_an_interrupt_in_a_function_says_where(tmp_path):
    file = written(tmp_path, FILE.replace("mine:mean", "mine:stops"))
    with pytest.raises(KeyboardInterrupt, match=r"^in method.mean \(.*mine.py, line \d+\)$"):
        run_study(read_design(file), tmp_path / "out")
