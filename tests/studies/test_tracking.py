import numpy as np
import pytest
import xarray as xr

from jaxtrack.studies import tables, tracking, tracking_paper, tracking_report
from jaxtrack.studies.csht import CELLS
from jaxtrack.studies.tracking_trial import FLOOR, TRACKERS, TRUTHS

NAMES = (*TRACKERS, FLOOR)
LOOKS = 199


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
            "near": (one, np.full(shape, 3)),
        },
        coords={"truth": list(TRUTHS), "tracker": list(NAMES), **rates},
    )


def verdicts(**options):
    rows = tracking_report.marks(made_up(**options), tracking._quiet())
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


def test_the_papers_distances_are_roots_of_squared_averages():
    for which in ("RATES", "SIGMA"):
        card, loc, all_ = (
            getattr(tracking_paper, f"{what}_BY_{which}")
            for what in ("CARDINALITY", "LOCALIZATION", "DISTANCE")
        )
        for who in ("CSHT", "Kalman"):
            np.testing.assert_allclose(np.hypot(card[who], loc[who]), all_[who], atol=0.008)


def test_combined_is_below_the_mean_distance_where_errors_of_number_come_and_go():
    table = made_up(late=20)
    mean = tracking_report._mean(table, 0, "visible", "hough joint", "distance")
    both = tracking_report._mean(table, 0, "visible", "hough joint", "combined")
    card, loc = 20 * 20 / LOOKS, 1.2 * (LOOKS - 20) / LOOKS
    np.testing.assert_allclose(mean.value, card + loc)
    np.testing.assert_allclose(both.value, np.hypot(card, loc))


def test_quiet_looks_are_those_outside_ten_seconds_after_a_birth_or_death():
    quiet = tracking._quiet()
    time_s = 1 + 0.5 * np.arange(LOOKS)
    assert not quiet[:20].any()
    assert quiet[20:41].all()
    assert not quiet[(time_s >= 22.0) & (time_s < 32.0)].any()
    assert quiet[-16:].all()


def test_figures_of_the_paper_are_found_by_rates():
    table = made_up(trials=2)
    at = [k for k, c in enumerate(CELLS) if (c.p_miss, c.p_false, c.sigma_m) == (0.1, 0.7, 3.0)]
    assert tracking_report.paper_figure(table, at[0], "distance", "CSHT") == 1.91
    noisy = [k for k, c in enumerate(CELLS) if c.sigma_m == 5.0]
    assert tracking_report.paper_figure(table, noisy[0], "cardinality", "Kalman") == 5.23
