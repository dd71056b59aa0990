"""From the lines of many trials to labelled scores: shares, means, errors, numbers of table 2."""

from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
import xarray as xr

from jaxtrack.hough import gate_for_false_rate
from jaxtrack.montecarlo import mean_and_error
from jaxtrack.studies.nht.trial import METHODS, PEAKS, Inputs, Outcome, Shape, scores
from jaxtrack.studies.tables import root_mean_square
from jaxtrack.types import Array, Key, Lines, Truth

FALSE_PER_RUN = 0.05  # of the voting methods: whole votes resolve no finer
FALSE_PER_RUN_JOINT = 0.02

Gates = dict[tuple[str, str], float]

_SCORES = ("match", "situation", "estimator", "peaks")  # `sel` has an argument `method`
_VARIABLES = (
    *("trials", "gate", "overflow", "top_k", "perfect", "found_all", "discrimination"),
    *("found", "found_error", "false", "false_error", "redundant", "redundant_error"),
    *("rho_rmse_m", "rho_rmse_lower_m", "rho_rmse_upper_m"),
    *("theta_rmse_rad", "theta_rmse_lower_rad", "theta_rmse_upper_rad"),
)
_WORDS = ("divergence", "divergence_error", "decline", "decline_error")


class Cell(NamedTuple):
    """The trials in one situation, and what they were run with."""

    situation: str
    shape: Shape
    inputs: Inputs
    key: Key
    gates: Gates
    outcome: Outcome  # leaves [trials, ...]


def derive_gates(outcome: Outcome) -> Gates:
    """Return each method's gate from scenes without targets, leaves [scenes, LINES]."""
    gates = {}
    for (method, form), lines in outcome.lines.items():
        allowed = FALSE_PER_RUN_JOINT if method == "joint" else FALSE_PER_RUN
        votes, mask = jnp.asarray(lines.votes), jnp.asarray(lines.mask)
        gates[method, form] = float(gate_for_false_rate(votes, mask, allowed))
    return gates


def dataset(cells: Sequence[Cell], match_m: Sequence[float]) -> xr.Dataset:
    """Return the scores of all cells by match, situation, estimator and form of peaks.

    `top_k`, `perfect` and `found_all` count trials; `found`, `false` and `redundant` are means over
    trials with their standard errors, at the gate; root mean square errors are over the targets
    found, with 95 % intervals; `discrimination` is the median. What was not run is NaN.
    """
    situations = list(dict.fromkeys(cell.situation for cell in cells))
    sides = (len(match_m), len(situations), len(METHODS), len(PEAKS))
    values = {name: np.full(sides, np.nan) for name in _VARIABLES}
    words = {name: np.full(sides[1:3], np.nan) for name in _WORDS}
    for cell in cells:
        place = situations.index(cell.situation)
        for (method, form), lines in cell.outcome.lines.items():
            at = (place, METHODS.index(method), PEAKS.index(form))
            gate = cell.gates[method, form]
            for row, distance_m in enumerate(match_m):
                summary = _summary(lines, cell.inputs.truth, distance_m, gate)
                summary["overflow"] = np.mean(cell.outcome.overflow[method, form])
                for name, value in summary.items():
                    values[name][(row, *at)] = value
        for name in ("divergence", "decline"):
            for method, number in getattr(cell.outcome, name).items():
                value, error = mean_and_error(np.asarray(number, np.float64).mean(-1))
                words[name][place, METHODS.index(method)] = value
                words[f"{name}_error"][place, METHODS.index(method)] = error
    return xr.Dataset(
        {
            **{name: (_SCORES, value) for name, value in values.items()},
            **{name: (_SCORES[1:3], value) for name, value in words.items()},
        },
        coords={
            "match": ("match", np.asarray(match_m, np.float64), {"units": "m"}),
            "situation": situations,
            "estimator": list(METHODS),
            "peaks": list(PEAKS),
        },
    )


def _summary(lines: Lines, truth: Truth, match_m: float, gate: float) -> dict[str, Any]:
    score = _score(lines, truth, match_m, gate)
    score = jax.tree.map(lambda x: np.asarray(x, np.float64), score)
    trials = len(score.found)
    summary: dict[str, Any] = {
        "trials": trials,
        "top_k": score.top_k.sum(),
        "perfect": score.perfect.sum(),
        "found_all": (score.found == truth.mask.shape[1]).sum(),
        "discrimination": np.median(score.discrimination),
        "gate": gate,
    }
    for name in ("found", "false", "redundant"):
        summary[name], summary[f"{name}_error"] = mean_and_error(getattr(score, name))
    for name, unit in (("rho", "m"), ("theta", "rad")):
        squares = (getattr(score, f"{name}_error_{unit}") ** 2).sum(-1)
        error = root_mean_square(squares, score.found, trials)
        summary[f"{name}_rmse_{unit}"] = error.value
        summary[f"{name}_rmse_lower_{unit}"] = error.lower
        summary[f"{name}_rmse_upper_{unit}"] = error.upper
    return summary


@jax.jit
def _score(lines: Lines, truth: Truth, match_m: Array, gate: Array) -> Any:
    return jax.vmap(lambda lines: scores(lines, truth, match_m, gate))(lines)


def gates_dataset(gates: Mapping[str, Gates], scenes: int) -> xr.Dataset:
    """Return the gates by table of clutter, method and form of the peaks."""
    table = np.full((len(gates), len(METHODS), len(PEAKS)), np.nan)
    for row, entries in enumerate(gates.values()):
        for (method, form), gate in entries.items():
            table[row, METHODS.index(method), PEAKS.index(form)] = gate
    return xr.Dataset(
        {"gate": (("clutter", "estimator", "peaks"), table)},
        coords={"clutter": list(gates), "estimator": list(METHODS), "peaks": list(PEAKS)},
        attrs={
            "scenes": scenes,
            "false_per_run": FALSE_PER_RUN,
            "false_per_run_joint": FALSE_PER_RUN_JOINT,
        },
    )
