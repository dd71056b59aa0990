"""The package as a whole: what it brings along, what it says about itself, what it leaves alone."""

import ast
import importlib
import importlib.metadata
import inspect
import pathlib
import pkgutil
import re
import subprocess
import sys
from importlib import resources

import pytest

import jaxtrack

ROOT = pathlib.Path(__file__).resolve().parent.parent
PACKAGE = ROOT / "jaxtrack"
SUBPACKAGES = [module.name for module in pkgutil.iter_modules(jaxtrack.__path__) if module.ispkg]
HEAVY = ("matplotlib", "xarray", "zarr", "tyro", "rich", "flax", "scipy")

OF_ESTIMATE = "a step of the module's `estimate`, which has the example"
SOFT = "`estimate` has the example; this one takes tolerances as well"
WITHOUT_EXAMPLE = {
    "hough.clustering_statistic.soft_estimate": SOFT,
    "hough.improved.soft_estimate": SOFT,
    "hough.modified.pair_votes": OF_ESTIMATE,
    "hough.modified.soft_estimate": SOFT,
    "hough.modified.vote_once": OF_ESTIMATE,
    "hough.neutrosophic.soft_estimate": SOFT,
    "hough.standard.rows": OF_ESTIMATE,
}


def test_an_import_brings_no_more_than_the_core_dependencies():
    script = f"import sys, jaxtrack; print(*sorted({set(HEAVY)!r} & set(sys.modules)))"
    run = subprocess.run(
        [sys.executable, "-W", "error", "-c", script], capture_output=True, text=True, check=True
    )
    assert run.stdout.split() == []


def test_an_import_changes_no_settings_of_jax():
    script = (
        "import jax; before = dict(jax.config.values); import jaxtrack; "
        "print(jax.config.values == before)"
    )
    run = subprocess.run([sys.executable, "-c", script], capture_output=True, text=True, check=True)
    assert run.stdout.strip() == "True"


def test_what_is_lazy_is_there_when_asked_for():
    for name in jaxtrack.__all__:
        assert getattr(jaxtrack, name) is not None
        assert name in dir(jaxtrack)
    with pytest.raises(AttributeError, match="no attribute 'nothing'"):
        jaxtrack.nothing  # noqa: B018


def test_it_is_typed_and_has_its_data_and_one_version():
    files = resources.files("jaxtrack")
    assert files.joinpath("py.typed").is_file()
    table = files.joinpath("sensors/data/radar_table3.csv").read_text().splitlines()
    assert len(table) == 22  # a header, three targets in seven looks
    stated = re.search(r'^version = "(.+)"$', (ROOT / "pyproject.toml").read_text(), re.MULTILINE)
    assert stated is not None
    assert jaxtrack.__version__ == stated[1] == importlib.metadata.version("jaxtrack")


def public_functions():
    """Yield every function of the subpackages' `__all__`, and those of the modules in there."""
    for name in SUBPACKAGES:
        package = importlib.import_module(f"jaxtrack.{name}")
        assert package.__doc__, name
        for public in package.__all__:
            thing = getattr(package, public)
            if inspect.isfunction(thing):
                yield f"{name}.{public}", thing
            elif inspect.ismodule(thing):
                for inner, function in inspect.getmembers(thing, inspect.isfunction):
                    if function.__module__ == thing.__name__ and not inner.startswith("_"):
                        yield f"{name}.{public}.{inner}", function


def test_every_public_function_has_an_example_or_a_reason_why_not():
    functions = dict(public_functions())
    assert len(functions) > 60
    without = {
        name
        for name, function in functions.items()
        if "Example:\n" not in (function.__doc__ or "") or ">>> " not in function.__doc__
    }
    assert without == set(WITHOUT_EXAMPLE)
    assert all(inspect.getdoc(function) for function in functions.values())


@pytest.mark.parametrize("name", SUBPACKAGES)
def test_what_a_subpackage_exports_exists(name):
    package = importlib.import_module(f"jaxtrack.{name}")
    exported = package.__all__
    assert len(set(exported)) == len(exported)
    for public in exported:
        assert hasattr(package, public)


def changes_of_jax_config(tree):
    """Yield the lines that call `….config.update` or assign to something in `jax.config`."""
    for node in ast.walk(tree):
        if isinstance(node, ast.Call) and isinstance(node.func, ast.Attribute):
            if ast.unparse(node.func).endswith("config.update"):
                yield node.lineno
        elif isinstance(node, ast.Assign) and any(
            ast.unparse(target).startswith("jax.config.") for target in node.targets
        ):
            yield node.lineno


def test_only_the_command_line_changes_settings_of_jax():
    assert list(changes_of_jax_config(ast.parse("import jax\njax.config.update('a', 1)"))) == [2]
    files = [path for path in PACKAGE.rglob("*.py") if path.parent != PACKAGE / "cli"]
    assert len(files) > 40
    lines = [
        f"{path.relative_to(ROOT)}:{line}"
        for path in files
        for line in changes_of_jax_config(ast.parse(path.read_text()))
    ]
    assert lines == []


def resolves(dotted):
    """Whether a name exists, reading each part as a module where it is one."""
    parts = dotted.split(".")
    for split in range(len(parts), 0, -1):
        try:
            thing = importlib.import_module(".".join(["jaxtrack", *parts[:split]]))
        except ModuleNotFoundError:
            continue
        for part in parts[split:]:
            if not hasattr(thing, part):
                return False
            thing = getattr(thing, part)
        return True
    return False


def test_the_table_of_equations_names_what_exists():
    text = (ROOT / "docs" / "equations.md").read_text()
    heads = "|".join([*SUBPACKAGES, "types", "cli"])
    names = set(re.findall(rf"`(?:jaxtrack\.)?((?:{heads})(?:\.\w+)+)`", text))
    assert len(names) > 30
    assert {name for name in names if not resolves(name)} == set()
    # A test that cannot fail proves nothing.
    assert not resolves("hough.joint.nothing")
    assert not resolves("hough.nothing.estimate")


def test_the_table_of_equations_has_every_equation_of_the_paper():
    text = (ROOT / "docs" / "equations.md").read_text()
    section = text.split("## Neutrosophic Hough transform")[1].split("\nBeside the equations")[0]
    numbers = set()
    for row in re.findall(r"^\| ([\d, –]+) \|", section, re.MULTILINE):
        for part in row.split(","):
            first, _, last = part.strip().partition("–")
            numbers |= set(range(int(first), int(last or first) + 1))
    assert numbers == set(range(1, 35))
