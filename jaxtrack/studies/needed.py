"""How many runs do I need: from the spread that the trials so far have, and how fast they ran.

The mean of n independent trials of standard deviation σ has the standard error σ / √n, so

    n = (σ / wanted)²      for a standard error,
    n = (2 σ_d / d)²       for a paired difference d of spread σ_d to be two of its errors from zero.
"""

import math
from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

from jaxtrack.studies.design import Design


class Known(NamedTuple):
    """A mean over the trials so far."""

    method: str
    cell: str  # its fields, in words
    mean: float
    error: float  # standard
    spread: float  # standard deviation of one trial


def means(
    design: Design, rows: Sequence[Mapping[str, Any]], metric: str, trials: int
) -> list[Known]:
    """Return each method's mean in the cell where the metric is known least.

    Args:
        design: of the study.
        rows: of `summary.rows`.
        metric: which.
        trials: so far.
    """
    of = lambda name: [_known(row, metric, trials) for row in rows if row["method"] == name]
    certain = lambda one: one.error if math.isfinite(one.error) else math.inf
    return [max(of(method.name), key=certain) for method in design.methods]


def differences(
    design: Design, rows: Sequence[Mapping[str, Any]], metric: str, trials: int
) -> list[Known]:
    """Return the paired differences from the first method, in every cell that has one."""
    head = f"{metric} - {design.methods[0].name}"
    return [_known(row, head, trials) for row in rows if head in row]


def trials_for(spread: float, wanted: float) -> float:
    """Return how many trials a standard error needs; NaN where the trials so far cannot tell.

    Example:
        >>> trials_for(2.0, 0.5)
        16
        >>> trials_for(0.0, 0.5)  # all the same so far
        nan
    """
    if not (math.isfinite(spread) and spread > 0 and wanted > 0):
        return math.nan
    return max(math.ceil((spread / wanted) ** 2 * (1 - 1e-9)), 1)


def _known(row: Mapping[str, Any], head: str, trials: int) -> Known:
    mean, error = row[head]
    fields = {k: v for k, v in row.items() if k != "method" and not isinstance(v, tuple)}
    cell = ", ".join(f"{name} {value}" for name, value in fields.items())
    return Known(row["method"], cell, mean, error, error * math.sqrt(trials))
