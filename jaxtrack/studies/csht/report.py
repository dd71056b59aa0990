"""The tables and marks of the study `csht_estimation`."""

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
import xarray as xr
from rich.table import Table

from jaxtrack.hough.clustering_params import ClusteringSizes
from jaxtrack.studies.csht import paper as csht_paper
from jaxtrack.studies.csht.trial import CUTOFF, ORDER
from jaxtrack.studies.tables import (
    Figure,
    Mark,
    Row,
    grid_table,
    mean_of,
    number,
    quotient,
    rate,
    standard_error,
)

_MEASURES = {
    "velocity": ("velocity_ospa", "m/s"),
    "position": ("position_ospa", "m"),
}
_PLACES = ClusteringSizes().patterns  # for tracks of the paper's votes


def gates(
    cells: Sequence[Any], found: Mapping[str, Sequence[float]], scenes: int, false_per_run: float
) -> Table:
    """Return the joint vote's gates, in nats, by cell and model of false alarms."""
    names = [cell_name(cell.p_miss, cell.p_false, cell.sigma_m) for cell in cells]
    lines = [[number(found[name][row]) for name in found] for row in range(len(cells))]
    title = (
        f"Gates of the joint vote from windows without targets, for at most {false_per_run:g} "
        "false tracks a window"
    )
    return grid_table(title, names, list(found), lines, trials=scenes)


def cell_name(p_miss: float, p_false: float, sigma_m: float) -> str:
    """Return what a cell is called.

    Example:
        >>> cell_name(0.3, 0.1, 3.0)
        'P_M .3, P_F .1, σ 3 m'
    """
    return f"P_M {p_miss:.1g}, P_F {p_false:.1g}, σ {sigma_m:g} m".replace("0.", ".")


def errors(table: xr.Dataset, title: str) -> list[Table]:
    """Return the tables of the right number, of velocities and of positions, cell by cell.

    Each title says by which cut-off and order, and what the columns are.

    Args:
        table: [cell, trial, estimator].
        title: what was simulated.
    """
    trials = table.sizes["trial"]
    names = [_name(table, cell) for cell in range(table.sizes["cell"])]
    estimators = [str(name) for name in table.estimator.values]
    methods = estimators[:3]
    right = exact(table)
    passes = table.passes_at_truth.mean("trial")
    shares = [
        [number(float(right.sel(estimator=m).mean("trial")[row])) for m in methods]
        + [_count(m, table["count"].sel(estimator=m).values[row]) for m in methods]
        + [number(float(passes[row]))]
        for row in range(len(names))
    ]
    columns = [f"{m} right" for m in methods] + [f"{m} count" for m in methods] + ["ceiling"]
    head = (
        f"{title}: number of targets (≥: runs in which all {_PLACES} places were taken; ceiling: "
        "share of runs in which the evidence at every target's true path passes the gate)"
    )
    tables = [grid_table(head, names, columns, shares, trials=trials)]
    for what, (field, unit) in _MEASURES.items():
        lines = []
        for row in range(len(names)):
            here = table[field][row]
            line = [_spread(here.sel(estimator=name).values) for name in estimators]
            only = here.sel(estimator="joint").values[right[row].sel(estimator="joint").values]
            paper = [_paper(what, name, table, row) for name in ("SHT", "CSHT")]
            lines.append([*line[:3], _spread(only), *line[3:], *paper])
        columns = [*methods, "joint, number right", *estimators[3:], "paper SHT", "paper CSHT"]
        head = (
            f"{title}: {what} OSPA of order {ORDER:g} with cut-off {CUTOFF:g} {unit}, "
            f"in {unit}, mean ± standard error (median)"
        )
        tables.append(grid_table(head, names, columns, lines, trials=trials))
    return tables


def effective_samples(table: xr.Dataset) -> str:
    """Return in a sentence how many samples the floor's posterior means stand on.

    Args:
        table: [cell, trial], the fewest of a trial's targets.
    """
    fewest = table.effective_samples.values
    low, middle = np.quantile(fewest, (0.01, 0.5))
    return (
        f"Effective samples of the floor's posterior mean, the fewest of a run's targets: median "
        f"{middle:.0f}, in one run of a hundred below {low:.0f}."
    )


def overflow(table: xr.Dataset) -> str:
    """Return in a sentence where the joint vote scored only some of the pairs of detections.

    Args:
        table: [cell, trial].
    """
    shares = table.overflow.astype(float).mean("trial").groupby("p_false").max()
    parts = [
        f"P_F {float(rate):.1g}: {number(float(share))}".replace("P_F 0.", "P_F .")
        for rate, share in zip(shares.p_false.values, shares.values, strict=True)
    ]
    return (
        "Share of runs in which there were more pairs of detections than the joint vote scores, "
        f"the largest of the cells of a rate of false alarms: {'; '.join(parts)}."
    )


def exact(table: xr.Dataset) -> xr.DataArray:
    """Return in which runs an estimator reports as many targets as there are."""
    return table["count"] == table.targets


def marks(
    table_2: Mapping[str, xr.Dataset],
    generated: xr.Dataset | None,
    outside: xr.Dataset | None = None,
) -> list[Row]:
    """Return every figure that has a mark; that nothing lies below the floor is one of all tables.

    Args:
        table_2: by model of false alarms, [cell, trial, estimator], the paper's scene.
        generated: [cell, trial, estimator], scenes of the generator that keep to its limits.
        outside: likewise, those that break one.
    """
    literal, one = table_2["literal"], table_2["one a scan"]
    rows: list[Row] = []
    for scene, table in (("", literal), ("generated, ", generated)):
        if table is None:
            continue
        for cell in range(table.sizes["cell"]):
            rows += _joint_rows(f"{scene}{_name(table, cell)}: joint", table.isel(cell=cell))
    others = {name: table for name, table in table_2.items() if name != "literal"}
    for scene, table in {**others, "generated outside the limits": outside}.items():
        if table is None or not table.sizes["trial"]:
            continue
        for cell in range(table.sizes["cell"]):
            name = f"{scene}, {_name(table, cell)}: joint"
            rows += _floor_rows(name, table.isel(cell=cell))
    for cell in range(literal.sizes["cell"]):
        here, name = literal.isel(cell=cell), _name(literal, cell)
        if float(here.p_miss) <= 0.3:
            paper = _paper("position", "CSHT", literal, cell)
            ours = mean_of(here.position_ospa.sel(estimator="joint").values, "m")
            bound = Mark(float(paper), at_least=False)
            rows.append(Row(f"{name}: joint, position, all runs", ours, paper, bound))
    at = (one.p_miss == 0.3) & (one.p_false == 0.3) & (one.sigma_m == 3.0)
    here = one.isel(cell=int(np.flatnonzero(at.values)[0]))
    right = exact(here).sel(estimator="CSHT").values
    position = here.position_ospa.sel(estimator="CSHT").values
    rows += [
        Row("one a scan, .3, .3, 3 m: CSHT, number right", _rate(right), "", Mark(0.90)),
        Row(
            "one a scan, .3, .3, 3 m: CSHT, median position",
            median(position, "m"),
            "2.14",
            Mark(3.0, at_least=False),
        ),
    ]
    return rows


def median(values: np.ndarray, unit: str) -> Figure:
    """Return a median with the 95 % interval of the order statistics.

    Example:
        >>> figure = median(np.arange(101.0), "m")
        >>> print(figure.value, figure.lower, figure.upper)
        50.0 40.0 60.0
    """
    n = len(values)
    if n == 0:
        return Figure(np.nan, np.nan, np.nan, 0, unit)
    ordered = np.sort(values)
    half = 1.96 * np.sqrt(n) / 2
    low, high = int(np.floor((n - 1) / 2 - half)), int(np.ceil((n - 1) / 2 + half))
    return Figure(
        float(np.median(values)),
        float(ordered[max(low, 0)]),
        float(ordered[min(high, n - 1)]),
        n,
        unit,
    )


def _joint_rows(name: str, here: xr.Dataset) -> list[Row]:
    """Return what the joint vote has to reach in a cell, and that nothing lies below the floor."""
    p_miss, p_false, sigma_m = (float(here[k]) for k in ("p_miss", "p_false", "sigma_m"))
    share, ratio = _wanted(p_miss, p_false, sigma_m)
    right = exact(here).sel(estimator="joint").values
    rows = [Row(f"{name}, number right", _rate(right), "", share)]
    if ratio is not None:
        bound = Mark(ratio, at_least=False)
        rows += [
            Row(f"{name}, {what} / floor", _over_floor(here, what), "", bound) for what in _MEASURES
        ]
    return rows + _floor_rows(name, here)


def _floor_rows(name: str, here: xr.Dataset) -> list[Row]:
    """Return that in a cell the joint vote's errors, where its number is right, are no less."""
    return [
        Row(f"{name}, {what} not below the floor", _over_floor(here, what), "", Mark(1.0))
        for what in _MEASURES
    ]


def _over_floor(here: xr.Dataset, what: str) -> Figure:
    """Return the joint vote's errors over the floor's, in the runs where its number is right."""
    right = exact(here).sel(estimator="joint").values
    of = lambda name: here[_MEASURES[what][0]].sel(estimator=name).values[right]
    return quotient(of("joint"), of("floor"))


def _wanted(p_miss: float, p_false: float, sigma_m: float) -> tuple[Mark | None, float | None]:
    if p_miss <= 0.3:
        return (Mark(0.98), 1.12) if sigma_m <= 3.0 else (Mark(0.94), 1.25)
    if p_miss == 0.5:
        wanted = {0.1: 0.92, 0.3: 0.76, 0.5: 0.70}
        return (Mark(wanted[p_false]) if p_false in wanted else None), None
    return None, None


def _name(table: xr.Dataset, cell: int) -> str:
    at = table.isel(cell=cell)
    return cell_name(float(at.p_miss), float(at.p_false), float(at.sigma_m))


def _spread(values: np.ndarray) -> str:
    if len(values) == 0:
        return "–"
    if len(values) == 1:
        return f"{values[0]:.3g}"
    return f"{values.mean():.3g} ± {standard_error(values):.2g} ({np.median(values):.3g})"


def _count(method: str, values: np.ndarray) -> str:
    """Return the mean number of estimates; of one that was out of places, no less than that."""
    full = method != "joint" and (values >= _PLACES).any()
    return f"{'≥ ' if full else ''}{values.mean():.2f}"


def _rate(hits: np.ndarray) -> Figure:
    return rate(float(hits.sum()), len(hits))


def _paper(what: str, method: str, table: xr.Dataset, cell: int) -> str:
    """Return the paper's figure of a cell, as it prints it."""
    at = table.isel(cell=cell)
    p_miss, p_false, sigma_m = (float(at[k]) for k in ("p_miss", "p_false", "sigma_m"))
    by_rates, by_sigma = {
        "velocity": (csht_paper.VELOCITY_BY_RATES, csht_paper.VELOCITY_BY_SIGMA),
        "position": (csht_paper.POSITION_BY_RATES, csht_paper.POSITION_BY_SIGMA),
    }[what]
    if sigma_m == 3.0:
        rates = csht_paper.RATES
        return f"{by_rates[method][rates.index(p_miss), rates.index(p_false)]:g}"
    return f"{by_sigma[method][csht_paper.SIGMAS_M.index(sigma_m)]:g}"


def vote_counts(counts: Mapping[str, tuple[float, float]]) -> str:
    """Return in a sentence why the one-coordinate vote fails where every beam may give an alarm.

    Args:
        counts: by model of false alarms, mean votes of the true lines' cells and of the strongest
            other cell.
    """
    parts = [
        f"{name}: the true lines' cells hold {true:.1f} votes on average, the strongest cell away "
        f"from them {other:.1f}"
        for name, (true, other) in counts.items()
    ]
    return "Votes of a window, " + "; ".join(parts) + "."
