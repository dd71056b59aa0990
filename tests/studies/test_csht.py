import numpy as np
import pytest
import xarray as xr

from jaxtrack.studies import tables
from jaxtrack.studies.csht import paper, report
from jaxtrack.studies.csht import study as csht
from jaxtrack.studies.csht.trial import KNOWN, METHODS


def made_up(cells, share_right=1.0, joint=1.05, trials=200):
    """Errors of 1 at the floor and of `joint` of the joint vote, right in a share of the runs."""
    names = (*METHODS, *KNOWN)
    shape = (len(cells), trials, len(names))
    errors = np.broadcast_to([20.0, 2.5, joint, 1.0, 1.1], shape).copy()
    count = np.full(shape, 3)
    count[:, round(share_right * trials) :, names.index("joint")] = 4
    dims = ("cell", "trial", "estimator")
    rates = {name: ("cell", [getattr(cell, name) for cell in cells]) for name in csht.Rates._fields}
    return xr.Dataset(
        {
            "velocity_ospa": (dims, errors),
            "position_ospa": (dims, errors),
            "count": (dims, count),
            "targets": (dims[:2], np.full(shape[:2], 3)),
            "passes_at_truth": (dims[:2], np.ones(shape[:2], bool)),
            "effective_samples": (dims[:2], np.full(shape[:2], 321.0)),
            "overflow": (dims[:2], np.outer(np.array(rates["p_false"][1]) >= 0.5, np.ones(trials))),
        },
        coords={"estimator": list(names), **rates},
    )


def verdicts(**options):
    table = made_up(csht.CELLS, **options)
    table_2 = dict.fromkeys(csht.VARIANTS, table)
    rows = report.marks(table_2, table, table)
    return {row.what: tables.verdict(row.ours, row.mark) for row in rows}


def test_good_figures_pass_and_few_say_smoke():
    good = verdicts()
    marked = {word for word in good.values() if word}
    assert marked == {"pass"}
    assert {word for word in verdicts(trials=19).values() if word} == {"smoke"}


def test_a_wrong_number_of_targets_fails_where_a_mark_stands():
    failed = {name for name, word in verdicts(share_right=0.8).items() if word == "fails"}
    assert all("number right" in name for name in failed)
    assert "P_M .3, P_F .3, σ 3 m: joint, number right" in failed
    assert "generated, P_M .3, P_F .7, σ 3 m: joint, number right" in failed
    assert not any("P_M .7" in name for name in failed)


def test_errors_above_the_bound_and_below_the_floor_fail():
    high = {name for name, word in verdicts(joint=1.2).items() if word == "fails"}
    assert "P_M .3, P_F .3, σ 3 m: joint, position / floor" in high
    assert "P_M .3, P_F .3, σ 5 m: joint, position / floor" not in high  # there 1.25 is asked
    low = {name for name, word in verdicts(joint=0.9).items() if word == "fails"}
    assert low
    assert all("not below the floor" in name for name in low)
    for scene in ("P_M", "generated, ", "clutter in ", "one a scan, ", "generated outside "):
        assert len([name for name in low if name.startswith(scene)]) == 2 * len(csht.CELLS)


def test_tables_hold_every_cell():
    made = report.errors(made_up(csht.CELLS), "made up")
    assert [table.row_count for table in made] == [len(csht.CELLS)] * 3
    number, velocity, position = (str(table.title) for table in made)
    assert "ceiling: share of runs in which the evidence" in number
    assert "OSPA of order 2 with cut-off 20 m/s" in velocity
    assert "OSPA of order 2 with cut-off 20 m," in position


def test_one_run_has_no_spread_and_full_tables_say_so():
    table = made_up(csht.CELLS, trials=1)
    table["count"].loc[{"estimator": "SHT"}] = 9
    number, velocity, _ = report.errors(table, "made up")
    assert set(number.columns[4].cells) == {"≥ 9.00"}
    assert set(number.columns[5].cells) == {"3.00"}
    assert set(velocity.columns[1].cells) == {"20"}


def test_pairs_that_did_not_fit_are_told():
    words = report.overflow(made_up(csht.CELLS))
    assert "P_F .1: .000; P_F .3: .000; P_F .5: 1; P_F .7: 1." in words


def test_gates_are_shipped_for_every_cell():
    gates = csht.shipped_gates()
    assert list(gates) == list(csht.VARIANTS)
    for table in gates.values():
        assert len(table) == len(csht.CELLS)
        assert min(table) >= csht.LEAST_GATE


def test_the_papers_tables_are_whole():
    for table in (paper.VELOCITY_BY_RATES, paper.POSITION_BY_RATES):
        assert all(rows.shape == (4, 4) for rows in table.values())
    # Where tables 3 and 5, and 4 and 6, show the same cell they agree.
    for rates, sigma in (
        (paper.VELOCITY_BY_RATES, paper.VELOCITY_BY_SIGMA),
        (paper.POSITION_BY_RATES, paper.POSITION_BY_SIGMA),
    ):
        for method in ("CSHT", "SHT"):
            assert rates[method][1, 1] == sigma[method][2]


def test_medians_and_quotients_carry_95_percent():
    rng = np.random.default_rng(0)
    hits = [
        figure.lower <= 0.0 <= figure.upper
        for figure in (report.median(rng.normal(size=60), "m") for _ in range(400))
    ]
    assert 0.91 < np.mean(hits) < 0.99
    ours, theirs = rng.normal(2.0, 0.5, 4000), rng.normal(1.0, 0.1, 4000)
    figure = tables.quotient(ours, theirs)
    assert figure.lower < 2.0 < figure.upper
    assert figure.upper - figure.lower < 0.05
    assert np.isnan(tables.quotient(np.zeros(0), np.zeros(0)).value)
    assert report.median(np.zeros(0), "m").trials == 0


def test_cells_are_named():
    assert report.cell_name(0.1, 0.7, 3.0) == "P_M .1, P_F .7, σ 3 m"
    assert csht.CELLS[0] == pytest.approx((0.1, 0.1, 3.0))
    assert len(csht.CELLS) == 20


def test_the_floors_samples_are_told():
    assert "median 321" in report.effective_samples(made_up(csht.CELLS))
