import jax
import jax.numpy as jnp
import numpy as np
import pytest
import xarray as xr

from jaxtrack.studies import tables
from jaxtrack.studies.tuned import nht as tune_nht
from jaxtrack.studies.tuned import report
from jaxtrack.studies.tuned.nht_trial import ORIGINS, loss_from, score_from
from tests.metrics.differences import assert_gradients_agree

METHODS = ("gradient", "TPE")


def made_up(trials=400, gradient=0.8, other=0.6, eps=((80.0, 0.06),) * 3, seconds=40.0):
    """Scores of which the paper's ε gets none, the wide one half of the scenes."""
    starts = list(tune_nht.STARTS)
    settings = ["paper", "wide", *(f"{method}, {start}" for method in METHODS for start in starts)]
    share = [0.0, 0.5, *[gradient] * 3, *[other] * 3]
    top = np.arange(trials)[:, None] < np.round(np.array(share) * trials)[None]
    both = np.stack([top, top], axis=-1)
    ends = np.stack([np.array(eps), np.full((3, 2), 0.1)])[:, :, None, :]
    way = ("case", "tuner", "start", "evaluation")
    twice = lambda x: np.stack([x, x])
    return xr.Dataset(
        {
            "score": (("case", "trial", "setting", "measure"), twice(1.0 - both)),
            "params": (("case", "setting", "parameter"), np.ones((2, len(settings), 2))),
            "overflow": (("case", "trial", "setting"), np.zeros((2, trials, len(settings)), bool)),
            "seconds": (way[:3], np.full((2, 2, 3), seconds)),
            "score_on_the_way": (way, np.full((2, 2, 3, 1), 0.5)),
            "params_on_the_way": ((*way, "parameter"), twice(ends)),
            "realizations": ("evaluation", np.array([100])),
        },
        coords={
            "case": list(ORIGINS),
            "setting": settings,
            "tuner": list(METHODS),
            "start": starts,
            "parameter": ["eps_rho_m", "eps_theta_rad"],
        },
    )


def verdicts(scores):
    return {row.what: tables.verdict(row.ours, row.mark) for row in tune_nht.marks(scores)}


def failed(scores):
    return [what for what, word in verdicts(scores).items() if word == "fails"]


def test_good_figures_pass_every_mark_and_few_scenes_say_smoke():
    words = verdicts(made_up())
    full = [word for what, word in words.items() if what.startswith("scenes in which")]
    assert full == ["", ""]
    words = {what: word for what, word in words.items() if not what.startswith("scenes in which")}
    assert set(words.values()) == {"pass"}
    assert len(words) == 2 * (2 + 3 + 1) + 1
    assert set(verdicts(made_up(trials=19)).values()) == {"smoke", ""}


def test_bad_figures_fail_their_own_mark():
    assert failed(made_up(gradient=0.55, other=0.5)) == [
        f"centre: top 3 above the paper's ε, from {start}" for start in tune_nht.STARTS
    ]
    worse = failed(made_up(gradient=0.75, other=0.9))
    assert worse == [f"{origin}: top 3 above TPE, mean of the starts" for origin in ORIGINS]
    apart = ((80.0, 0.06), (80.0, 0.06), (95.0, 0.06))
    assert failed(made_up(eps=apart)) == [f"{o}: ε_ρ, largest / smallest end" for o in ORIGINS]
    assert failed(made_up(seconds=130.0)) == ["slowest tuning, compilation included"]
    assert "slowest tuning, compilation included" not in verdicts(made_up(seconds=np.nan))


def test_a_table_has_every_setting_and_its_standard_error():
    table = report.table(made_up(), "corner", tune_nht.WORDS)
    cells = [list(column.cells) for column in table.columns]
    assert cells[0][:3] == [
        "the paper's ε, the default", "study nht's wide ε", "gradient, the paper's"
    ]  # fmt: skip
    assert cells[3][2] == ".800 ± .020"
    assert cells[5][:3] == ["", "", "100"]


@pytest.mark.slow
def test_the_loss_is_smooth_in_both_tolerances():
    loss, key = loss_from("centre"), jax.random.key(1)

    def of_logs(free):
        eps = jnp.exp(free)
        return loss({"eps_rho_m": eps[0], "eps_theta_rad": eps[1]}, key)

    gradient, = assert_gradients_agree(of_logs, np.log([70.0, 0.06]), rtol=1e-5)  # fmt: skip
    assert np.abs(gradient).max() > 1e-2


@pytest.mark.slow
def test_scores_are_of_the_estimator():
    run = jax.jit(score_from("centre"))
    keys = [jax.random.key(seed) for seed in range(6)]
    settings = [{"eps_rho_m": r, "eps_theta_rad": t} for r, t in ((20.0, 0.004), (70.0, 0.06))]
    missed = np.array([[run(each, key).value for each in settings] for key in keys])
    assert missed.shape == (6, 2, 2)
    assert missed[:, 0].mean() > missed[:, 1].mean()  # the paper's, and wider ones
    assert (missed[..., 0] >= missed[..., 1]).all()  # what is right at 50 m is so at 100 m
