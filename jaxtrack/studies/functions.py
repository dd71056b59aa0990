"""The functions that a study names: built in, or anyone's own by import path."""

import hashlib
import importlib
import importlib.util
import pathlib
import sys
from collections.abc import Callable
from importlib import resources
from typing import Any

from jaxtrack.studies import builtin
from jaxtrack.studies.study_file import StudyError

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
    own = folder.joinpath(*module.split(".")).with_suffix(".py")
    found = getattr(_own_module(own) if own.is_file() else _module(module), function, None)
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


def _module(name: str) -> Any:
    try:
        return importlib.import_module(name)
    except (ValueError, TypeError) as error:  # an empty or a relative name
        raise ImportError(f"got {name!r}, want the name of a module") from error


def _own_module(file: pathlib.Path) -> Any:
    """Import a file under a name of its own: folders may have files of the same name."""
    digest = hashlib.sha256(str(file).encode() + file.read_bytes()).hexdigest()[:16]
    name = f"{file.stem}_{digest}"
    if name in sys.modules:
        return sys.modules[name]
    spec = importlib.util.spec_from_file_location(name, file)
    if spec is None or spec.loader is None:
        raise ImportError(f"{file} is no module")
    module = importlib.util.module_from_spec(spec)
    sys.modules[name] = module
    sys.path.insert(0, str(file.parent))  # for the files beside it
    try:
        spec.loader.exec_module(module)
    except Exception as error:
        del sys.modules[name]
        raise ImportError(f"{file}: {type(error).__name__}: {error}") from error
    finally:
        sys.path.remove(str(file.parent))
    return module
