"""The functions that a study names: built in, or anyone's own by import path."""

import ast
import contextlib
import hashlib
import importlib
import importlib.util
import itertools
import pathlib
import sys
from collections.abc import Callable, Iterator
from importlib import resources
from typing import Any

from jaxtrack.studies import builtin
from jaxtrack.studies.study_file import StudyError

_OWN: dict[pathlib.Path, str] = {}  # files that were imported for a study, with their digests
_SHIPPED = pathlib.Path(str(resources.files("jaxtrack.studies") / "files"))
_BUILT_IN = {"scene": builtin.SCENES, "method": builtin.METHODS, "metric": builtin.METRICS}


def find_function(kind: str, name: str, folder: pathlib.Path) -> Callable[..., Any]:
    """Return a function by its name.

    Args:
        kind: "scene", "method" or "metric".
        name: of a built-in one, or `package.module:function`.
        folder: looked through before anything that is installed.

    Raises:
        ValueError: there is no such function.
        ImportError: there is no such module, or it cannot be imported.

    Example:
        >>> find_function("metric", "targets_found", pathlib.Path()).__name__
        'targets_found'
        >>> find_function("method", "statistics:mean", pathlib.Path())([1, 3])
        2
    """
    module, colon, function = name.partition(":")
    if not colon:
        known = _BUILT_IN[kind]
        if name not in known:
            want = f"one of {', '.join(known)}, or module:function"
            raise ValueError(f"got {name!r}, want {want}")
        return known[name]
    own = own_file(name, folder)
    found = getattr(_module(module) if own is None else _own_module(own), function, None)
    if not callable(found):
        raise ValueError(f"got {name!r}, but {module} has no function {function}")
    return found


def shipped_study(name: str) -> pathlib.Path:
    """Return the file of a study that comes with the package.

    Raises:
        StudyError: there is none of that name.

    Example:
        >>> shipped_study("crossing").is_file()
        True
    """
    if name not in shipped_studies():
        names = ", ".join(shipped_studies())
        raise StudyError(f"{name}: no such file, and no study of that name; there are: {names}")
    return _SHIPPED / f"{name}.toml"


def shipped_studies() -> tuple[str, ...]:
    """Return the names of the studies that come with the package.

    Example:
        >>> "crossing" in shipped_studies()
        True
    """
    return tuple(sorted(file.stem for file in _SHIPPED.glob("*.toml")))


def forget_others(folder: pathlib.Path) -> None:
    """Let studies' own files be imported anew if one has changed, or if they are another folder's.

    Python would take what it has imported by that name before.
    """
    if all(
        folder in file.parents and file.is_file() and _digest(file) == digest
        for file, digest in _OWN.items()
    ):
        return
    for name, module in list(sys.modules.items()):
        if pathlib.Path(getattr(module, "__file__", None) or "") in _OWN:
            del sys.modules[name]
    _OWN.clear()


@contextlib.contextmanager
def beside(folder: pathlib.Path) -> Iterator[None]:
    """Let what runs meanwhile import files of a folder."""
    sys.path.insert(0, str(folder))
    try:
        yield
    finally:
        sys.path.remove(str(folder))


def own_file(name: str, folder: pathlib.Path) -> pathlib.Path | None:
    """Return the file in a study's folder that a function's name means; None for others."""
    module, colon, _ = name.partition(":")
    file = folder.joinpath(*module.split(".")).with_suffix(".py")
    return file if colon and module and file.is_file() else None


def files_of(file: pathlib.Path) -> dict[pathlib.Path, str]:
    """Return a file and those beside it that it imports, however deep, with their digests.

    Read, not run: what is imported by a name that is made up at run time is not seen.
    """
    found: dict[pathlib.Path, str] = {}
    left = [file]
    while left:
        one = left.pop()
        if one in found or file.parent not in one.parents:
            continue
        found[one] = digest_of(one)
        with contextlib.suppress(SyntaxError, ValueError, IndexError):  # Python will complain of it
            for node in ast.walk(ast.parse(one.read_bytes())):
                left += _imported(node, one, file.parent)
    return found


def digest_of(file: pathlib.Path) -> str:
    """Return the digest of a file: as it was when it was imported, whatever it is now."""
    return _OWN.get(file) or _digest(file)


def _digest(file: pathlib.Path) -> str:
    return hashlib.sha256(file.read_bytes()).hexdigest()


def _imported(node: ast.AST, file: pathlib.Path, root: pathlib.Path) -> list[pathlib.Path]:
    """Return the files that a statement imports: of packages on the way those that make them."""
    names: list[str] = []
    if isinstance(node, ast.Import):
        names = [alias.name for alias in node.names]
    if isinstance(node, ast.ImportFrom):
        root = file.parents[node.level - 1] if node.level else root
        names = [f"{node.module or ''}.{alias.name}".lstrip(".") for alias in node.names]
    ways: list[pathlib.Path] = []
    for name in names:
        ways += itertools.accumulate(name.split("."), pathlib.Path.joinpath, initial=root)
    files = {file for way in ways for file in (way.with_suffix(".py"), way / "__init__.py")}
    return [file for file in files if file.is_file()]


def _module(name: str) -> Any:
    if not name or name.startswith("."):
        raise ImportError(f"got {name!r}, want the name of a module")
    try:
        return importlib.import_module(name)
    except ImportError:
        raise
    except (Exception, SystemExit) as error:
        raise ImportError(f"{name}: {type(error).__name__}: {error}") from error


def _own_module(file: pathlib.Path) -> Any:
    """Import a file under a name of its own: folders may have files of the same name."""
    digest = hashlib.sha256(str(file).encode()).hexdigest()[:16]
    name = f"{file.stem}_{digest}"
    if name in sys.modules:
        return sys.modules[name]
    spec = importlib.util.spec_from_file_location(name, file)
    if spec is None or spec.loader is None:
        raise ImportError(f"{file} is no module")
    _OWN.update(files_of(file))
    module = importlib.util.module_from_spec(spec)
    sys.modules[name] = module
    try:
        with beside(file.parent):
            spec.loader.exec_module(module)
    except (Exception, SystemExit) as error:
        del sys.modules[name]
        raise ImportError(f"{file}: {type(error).__name__}: {error}") from error
    return module
