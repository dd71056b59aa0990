import numpy as np
import pytest
import xarray as xr

from jaxtrack.studies import ccm, ccm_report, tables
from jaxtrack.studies.ccm_trial import METHODS


def made_up(trials=1000, **failed):
    """Runs that fail in the shares asked for, as `{"A3 cloud": 0.01}`; distances as in readings."""
    cells = list(ccm.cells())
    dims = ("cell", "trial", "associator")
    shape = (len(cells), trials, len(METHODS))
    loss = np.zeros(shape, bool)
    for where, share in failed.items():
        cell, method = where.split("_")
        loss[cells.index(cell), : round(share * trials), METHODS.index(method)] = True
    size = np.ones(len(METHODS))
    for method, rmse in (("nearest", 0.55), ("jpda", 0.33), ("cloud", 0.29)):
        size[METHODS.index(method)] = rmse
    noise = np.random.default_rng(0).chisquare(48, shape) / 48
    return xr.Dataset(
        {
            "swap": (dims, np.zeros(shape, bool)),
            "loss": (dims, loss),
            "squared_m2": (dims, size**2 * noise),
        },
        coords={"cell": cells, "associator": list(METHODS)},
    )


def verdicts(scores):
    return {row.what: tables.verdict(row.ours, row.mark) for row in ccm_report.marks(scores)}


def test_the_readings_figures_pass_every_mark_and_few_runs_say_smoke():
    good = {"A3_cloud": 0.01, "A3_jpda": 0.4, "B_cloud": 0.003, "D_pmht": 0.01}
    assert set(verdicts(made_up(**good)).values()) == {"pass"}
    assert set(verdicts(made_up(trials=19, **good)).values()) == {"smoke"}


@pytest.mark.parametrize(
    ("change", "what"),
    [
        ({"A3_cloud": 0.06}, "A3: cloud, swapped or lost"),
        ({"A3_jpda": 0.1}, "A3: jpda, swapped or lost"),
        ({"B_cloud": 0.04}, "B: cloud, swapped or lost"),
        ({"D_pmht": 0.06}, "D: pmht, swapped or lost"),
    ],
)
def test_too_many_failures_fail(change, what):
    good = {"A3_cloud": 0.01, "A3_jpda": 0.4, "B_cloud": 0.003, "D_pmht": 0.01}
    found = verdicts(made_up(**good | change))
    assert [name for name, word in found.items() if word == "fails"] == [what]


def test_distances_and_their_quotients_are_roots_of_mean_squares():
    scores = made_up()
    squares = {m: scores.squared_m2.sel(cell="A", associator=m).values for m in ("cloud", "jpda")}
    one = ccm_report.rmse(scores, "A", "cloud")
    np.testing.assert_allclose(one.value, np.sqrt(squares["cloud"].mean()))
    found = ccm_report.ratio(scores, "A", "cloud", "jpda")
    np.testing.assert_allclose(
        found.value, np.sqrt(squares["cloud"].mean() / squares["jpda"].mean())
    )
    draws = np.random.default_rng(1).integers(0, 1000, (400, 1000))
    again = np.sqrt(squares["cloud"][draws].mean(1) / squares["jpda"][draws].mean(1))
    low, high = np.quantile(again, [0.025, 0.975])
    np.testing.assert_allclose([found.lower, found.upper], [low, high], atol=0.3 * (high - low))


def test_the_claim_is_told_where_it_holds_and_where_the_contrary_does():
    scores = made_up(A_jpda=0.2, E_cloud=0.2)
    said = ccm_report.tables(scores, ["A", "B", "E"])[2]
    rows = list(zip(*(column._cells for column in said.columns), strict=True))
    of = said.columns[5].header, said.columns[6].header
    assert of == ("failures\njpda", "distance\njpda")
    assert [row[5] for row in rows] == ["holds", "alike", "contrary"]
    assert {row[6] for row in rows} == {"holds"}
