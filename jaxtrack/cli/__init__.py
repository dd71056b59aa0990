"""The command line: tracks in a file, the papers' studies, and studies of one's own.

Thin on purpose: it reads options, calls the library and prints. Users' errors are one line on
stderr and exit code 2.
"""

import sys
from collections.abc import Sequence

from jaxtrack.cli.files import estimate, initiate, track
from jaxtrack.cli.screen import fail
from jaxtrack.cli.studies import list_studies, reproduce
from jaxtrack.cli.study import study

_EXTRAS = ("tyro", "rich", "matplotlib", "mpl_toolkits", "xarray", "zarr")

__all__ = ["main"]


def main(argv: Sequence[str] | None = None) -> int:
    """Run the command line.

    Args:
        argv: arguments; None: those of the process.

    Returns:
        0, 2 for a user's error, or 130 after Ctrl-C.

    Example:
        >>> main(["reproduce", "nothing"])  # says on stderr which studies there are
        2
    """
    try:
        import tyro

        commands = {
            "initiate": initiate,
            "estimate": estimate,
            "track": track,
            "list": list_studies,
            "reproduce": reproduce,
            "study": study,
        }
        return tyro.extras.subcommand_cli_from_dict(
            commands,  # pyright: ignore[reportArgumentType]
            prog="jaxtrack",
            description="Estimators for tracking in sonar and radar data.",
            args=argv,
        )
    except ModuleNotFoundError as error:
        if (error.name or "").partition(".")[0] not in _EXTRAS:
            raise
        return fail(f"{error.name} is not installed: pip install 'jaxtrack[studies,plots]'")
    except KeyboardInterrupt as error:
        print(f"jaxtrack: interrupted {error}".rstrip(), file=sys.stderr)
        return 130
    except SystemExit as error:  # --help, or options that tyro has already complained of
        return error.code if isinstance(error.code, int) else 2
