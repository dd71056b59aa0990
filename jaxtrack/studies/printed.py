"""The figures that papers print, as the shipped studies' files have them under `[[compare]]`."""

import tomllib
from importlib import resources

import numpy as np


def printed(study: str, metric: str) -> dict[str, np.ndarray]:
    """Return a paper's figures of a metric, by method, over the cells of the file.

    Args:
        study: the name of a shipped file.
        metric: as the file calls it.

    Example:
        >>> print(printed("csht_estimation_noise", "position_ospa_m")["CSHT"])
        [1.29 1.75 2.14 2.34 2.85]
    """
    file = resources.files("jaxtrack.studies") / "files" / f"{study}.toml"
    tables = tomllib.loads(file.read_text(encoding="utf-8"))["compare"]
    ours = [
        one for one in tables if one["name"] == "paper" and metric in np.atleast_1d(one["metric"])
    ]
    found = {one["method"]: np.array(one["value"]) for one in ours}
    if len(found) != len(ours):
        raise ValueError(f"metric: got {metric}, want one with a single table a method in {study}")
    return found
