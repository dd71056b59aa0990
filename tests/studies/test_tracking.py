import numpy as np
import pytest
import xarray as xr

from jaxtrack.sensors import tracking_scene
from jaxtrack.studies import tables
from jaxtrack.studies.csht.study import CELLS
from jaxtrack.studies.tracking import consistency, report
from jaxtrack.studies.tracking import paper as tracking_paper
from jaxtrack.studies.tracking import study as tracking
from jaxtrack.studies.tracking.trial import FLOOR, TRACKERS, TRUTHS, quiet_looks
from jaxtrack.types import Truth

NAMES = (*TRACKERS, FLOOR)
LOOKS = 199
QUIET = np.asarray(quiet_looks(tracking_scene("visible").truth))


def made_up(*, joint=1.2, late=0, share_right=1.0, nees=4.0, trials=100):
    """Runs whose localization error is 1 at the floor, and `late` looks late with every target."""
    size = np.array([joint, 18.0, 15.0, 9.0, 1.0])
    loc = np.broadcast_to(size, (len(CELLS), trials, 2, LOOKS, len(NAMES))).swapaxes(-1, -2).copy()
    card = np.zeros_like(loc)
    card[..., :late] = 20.0
    wrong = round(share_right * trials)
    card[:, wrong:, :, NAMES.index("hough joint"), 30] = 10.0
    loc[..., :late] = 0.0
    dims = ("cell", "trial", "truth", "tracker", "look")
    one = ("cell", "trial", "tracker", "look")
    shape = card[:, :, 0].shape
    rates = {k: ("cell", [getattr(cell, k) for cell in CELLS]) for k in tracking.Rates._fields}
    return xr.Dataset(
        {
            "distance": (dims, np.hypot(loc, card)),
            "localization": (dims, loc),
            "cardinality": (dims, card),
            "nees": (one, np.full(shape, 3 * nees)),
            "own": (one, np.full(shape, 3)),
            "strays": (one, np.full(shape, 1)),
            "quiet": (("cell", "trial", "look"), np.broadcast_to(QUIET, (*shape[:2], LOOKS))),
            "full": (one, np.broadcast_to(np.array(NAMES)[:, None] == "kalman paper", shape)),
        },
        coords={"truth": list(TRUTHS), "tracker": list(NAMES), **rates},
    )


def verdicts(**options):
    rows = report.marks(made_up(**options), made_up(**options).isel(cell=[5]))
    return {row.what: tables.verdict(row.ours, row.mark) for row in rows}


def test_good_figures_pass_and_few_say_smoke():
    assert set(verdicts().values()) == {"pass"}
    assert set(verdicts(trials=5).values()) == {"smoke"}


@pytest.mark.parametrize(
    ("change", "what"),
    [
        ({"joint": 0.9}, "delay floor"),
        ({"joint": 16.0}, "kalman"),
        ({"joint": 2.9}, "mean OSPA"),
        ({"share_right": 0.8}, "right number"),
        ({"nees": 6.0}, "NEES"),
        ({"nees": 2.0}, "NEES"),
    ],
)
def test_what_a_mark_forbids_fails(change, what):
    failed = [name for name, word in verdicts(**change).items() if word == "fails"]
    assert any(what in name for name in failed)


def test_generated_scenes_are_judged_too_where_there_are_some():
    good, bad = made_up(), made_up(share_right=0.8).isel(cell=[5])
    rows = {row.what: row for row in report.marks(good, bad)}
    row = rows["generated scenes: hough joint, runs of the right number throughout"]
    assert tables.verdict(row.ours, row.mark) == "fails"
    assert not any(name.startswith("generated") for name in
                   (row.what for row in report.marks(good)))  # fmt: skip


def test_the_papers_distances_are_roots_of_squared_averages():
    for printed in (tracking_paper.BY_RATES, tracking_paper.BY_SIGMA):
        card, loc, all_ = (printed[what] for what in ("cardinality", "localization", "distance"))
        for who in ("CSHT", "Kalman"):
            np.testing.assert_allclose(np.hypot(card[who], loc[who]), all_[who], atol=0.008)


def test_combined_is_below_the_mean_distance_where_errors_of_number_come_and_go():
    table = made_up(late=20)
    mean = report._mean(table, 0, "visible", "hough joint", "distance")
    both = report._mean(table, 0, "visible", "hough joint", "combined")
    card, loc = 20 * 20 / LOOKS, 1.2 * (LOOKS - 20) / LOOKS
    np.testing.assert_allclose(mean.value, card + loc)
    np.testing.assert_allclose(both.value, np.hypot(card, loc))


def test_quiet_looks_are_those_outside_ten_seconds_after_a_birth_or_death():
    quiet = QUIET
    time_s = 1 + 0.5 * np.arange(LOOKS)
    assert not quiet[:20].any()
    assert quiet[20:41].all()
    assert not quiet[(time_s >= 22.0) & (time_s < 32.0)].any()
    assert quiet[-16:].all()


def test_figures_of_the_paper_are_found_by_rates():
    table = made_up(trials=2)
    at = [k for k, c in enumerate(CELLS) if (c.p_miss, c.p_false, c.sigma_m) == (0.1, 0.7, 3.0)]
    assert report.paper_figure(table, at[0], "distance", "CSHT") == 1.91
    noisy = [k for k, c in enumerate(CELLS) if c.sigma_m == 5.0]
    assert report.paper_figure(table, noisy[0], "cardinality", "Kalman") == 5.23


def test_the_report_counts_what_is_left_out_and_which_tables_were_full():
    table = made_up(trials=2)
    grid = report.consistency(table, "literal")
    assert all(cell == "4.0\n25.0 % left out" for cell in grid.columns[1]._cells)
    said = report.full(table)
    assert "hough joint 0.0 %," in said
    assert "kalman paper 100.0 % (at most 100.0 %" in said


def test_a_track_is_the_targets_that_it_is_near_most_of_its_life():
    looks = 9
    state = np.zeros((looks, 2, 4))
    state[:, 1, 0] = 500.0
    there = np.ones((looks, 2), bool)
    there[7:, 0] = False  # the first target goes
    mean = np.zeros((looks, 4, 4))
    mean[:, 0, 1] = 2.0  # the first target's track, which outlives it
    mean[:, 1, 0] = np.where(np.arange(looks) < 3, 5.0, 90.0)  # passes it, and is false
    mean[:, 2, 0] = np.where(np.arange(looks) < 4, 505.0, 900.0)  # two lives in a slot
    mean[:, 3] = 3.0  # a short life beside the first one's
    identity = np.tile([4, 5, 6, 8], (looks, 1))
    identity[4:, 2] = 7
    mask = np.ones((looks, 4), bool)
    mask[6, 0] = False
    mask[:, 3] = (np.arange(looks) == 1) | (np.arange(looks) == 2)
    covariance = np.broadcast_to(4.0 * np.eye(4), (looks, 4, 4, 4))
    found = consistency.Found(mean, covariance, mask, identity)
    truth = Truth(np.arange(looks), state, there)  # pyright: ignore
    owner = np.asarray(consistency.owners(found, truth))
    assert (owner[mask[:, 0], 0] == 0).all()
    assert (owner[:, 1] == -1).all()
    assert owner[:, 2].tolist() == [1] * 4 + [-1] * 5
    assert (owner[mask[:, 3], 3] == -1).all()
    squared, own, strays = consistency.consistency_of(found, truth)
    np.testing.assert_array_equal(own, [2, 2, 2, 2, 1, 1, 0, 0, 0])
    np.testing.assert_array_equal(strays, [1, 2, 2, 1, 2, 2, 2, 3, 3])
    first = np.where(np.arange(looks) < 6, 1.0, 0.0)
    np.testing.assert_allclose(squared, first + np.where(np.arange(looks) < 4, 25 / 4, 0.0))
