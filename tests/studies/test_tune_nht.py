import io
import json

import jax
import jax.numpy as jnp
import numpy as np
import pytest
import xarray as xr
from rich.console import Console

from jaxtrack.studies import STUDIES, Context, store, tables, tpe, tune_nht, tune_nht_report
from jaxtrack.studies.tune_nht_trial import ORIGINS, loss_from, missed_from, score_of
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
    way = ("origin", "tuner", "start", "evaluation")
    twice = lambda x: np.stack([x, x])
    return xr.Dataset(
        {
            "top_3": (("origin", "trial", "setting", "match"), twice(both)),
            "eps": (("origin", "setting", "parameter"), np.ones((2, len(settings), 2))),
            "overflow": (("origin", "trial"), np.zeros((2, trials), bool)),
            "seconds": (way[:3], np.full((2, 2, 3), seconds)),
            "top_3_on_the_way": (way, np.full((2, 2, 3, 1), 0.5)),
            "eps_on_the_way": ((*way, "parameter"), twice(ends)),
            "realizations": ("evaluation", np.array([100])),
        },
        coords={
            "origin": list(ORIGINS),
            "setting": settings,
            "match": [50.0, 100.0],
            "tuner": list(METHODS),
            "start": starts,
            "parameter": ["eps_rho_m", "eps_theta_rad"],
        },
    )


def verdicts(scores):
    return {row.what: tables.verdict(row.ours, row.mark) for row in tune_nht_report.marks(scores)}


def failed(scores):
    return [what for what, word in verdicts(scores).items() if word == "fails"]


def test_good_figures_pass_every_mark_and_few_scenes_say_smoke():
    words = verdicts(made_up())
    assert words.pop("scenes in which a table overflowed") == ""
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
    table = tune_nht_report.table(made_up(), "corner")
    cells = [list(column.cells) for column in table.columns]
    assert cells[0][:3] == [
        "the paper's ε, the default", "study nht's wide ε", "gradient, the paper's"
    ]  # fmt: skip
    assert cells[3][2] == ".800 ± .020"
    assert cells[5][:3] == ["", "", "100"]


def test_the_loss_is_smooth_in_both_tolerances():
    loss, key = loss_from("centre"), jax.random.key(1)

    def of_logs(free):
        eps = jnp.exp(free)
        return loss({"eps_rho_m": eps[0], "eps_theta_rad": eps[1]}, key)

    gradient, = assert_gradients_agree(of_logs, np.log([70.0, 0.06]), rtol=1e-5)  # fmt: skip
    assert np.abs(gradient).max() > 1e-2


@pytest.mark.slow
def test_scores_are_of_the_estimator_and_what_searches_see_is_their_rest():
    eps = {"eps_rho_m": jnp.array([20.0, 70.0]), "eps_theta_rad": jnp.array([0.004, 0.06])}
    run = jax.jit(score_of())
    keys = [jax.random.key(seed) for seed in range(6)]
    top = np.stack([run(key, (jnp.array(ORIGINS["centre"]), eps)).top_3 for key in keys])
    assert top.shape == (6, 2, 2)
    assert top[:, 0].mean() < top[:, 1].mean()  # the paper's, and wider ones
    assert (top[..., 0] <= top[..., 1]).all()  # what is right at 50 m is so at 100 m
    missed = jax.jit(missed_from("centre"))
    second = {name: x[1] for name, x in eps.items()}
    assert [float(missed(second, key)) for key in keys] == (1.0 - top[:, 1, 0]).tolist()


def test_a_search_spends_what_a_fit_does_and_returns_the_best_that_was_held_out():
    pytest.importorskip("optuna")

    def bowl(params, key):
        return jnp.log(params["x"] / 3.0) ** 2 + 0.01 * jax.random.normal(key)

    def run(seed=0):
        return tpe.search(
            bowl, {"x": 90.0}, {"x": (0.1, 100.0)}, key=jax.random.key(seed), steps=40, batch=4,
            holdout=8, every=10, progress=lambda *_: None,
        )  # fmt: skip

    found = run()
    assert found.tried["x"].shape == found.loss.shape == (40,)
    assert found.tried["x"][0] == 90.0
    assert found.best.shape == found.held_out.shape == (5,)
    assert found.best[0] == 0
    assert found.best[-1] == np.argmin(found.loss)
    assert abs(np.log(found.tried["x"][found.best[-1]] / 3.0)) < 0.5
    jax.tree.map(np.testing.assert_array_equal, run(), found)
    assert (run(1).tried["x"][1:] != found.tried["x"][1:]).any()


@pytest.mark.slow
@pytest.mark.parametrize("installed", [True, False])
def test_a_tiny_run_writes_all_its_files_and_gives_no_verdict(tmp_path, monkeypatch, installed):
    if installed:
        pytest.importorskip("optuna")
    else:
        monkeypatch.setattr(tpe, "is_installed", lambda: False)
    screen = io.StringIO()
    context = Context(tmp_path, 2, 7, Console(file=screen, width=160), lambda *_: None)
    STUDIES["tune_nht"].run(context)

    text = screen.getvalue()
    assert "smoke" in text
    assert "pass" not in text
    assert "fails" not in text
    assert ("Optuna is not installed" in text) is not installed
    groups, summary = store.load(tmp_path)
    assert list(groups) == ["scores", "maps"]
    methods = ["gradient", "TPE", "TPE on top 3"] if installed else ["gradient"]
    assert list(groups["scores"].tuner.values) == methods
    assert np.isfinite(groups["maps"].loss).all()
    assert {row["verdict"] for row in summary["marks"]} == {"smoke", ""}
    json.dumps(summary, allow_nan=False)
    assert len(list(tmp_path.glob("*.png"))) == 5
    assert not (tmp_path / "parts").exists()


@pytest.mark.slow
def test_an_interrupted_run_goes_on_where_it_was(tmp_path, monkeypatch):
    monkeypatch.setattr(tpe, "is_installed", lambda: False)
    context = Context(tmp_path, 2, 7, Console(quiet=True), lambda *_: None)
    whole, _ = tune_nht.tune_all(context._replace(out=tmp_path / "whole"), tune_nht.SMOKE)

    def stop(what, done, total):
        if (what, done) == ("gradient, corner, a tenth", 3):
            raise KeyError

    with pytest.raises(KeyError):
        tune_nht.tune_all(context._replace(progress=stop), tune_nht.SMOKE)
    seen = []
    again = context._replace(progress=lambda *at: seen.append(at))
    ways, _ = tune_nht.tune_all(again, tune_nht.SMOKE)
    assert seen[0] == ("gradient, corner, a tenth", 3, 4)
    for name, way in whole.items():
        np.testing.assert_array_equal(ways[name].steps, way.steps)
        np.testing.assert_array_equal(ways[name].eps, way.eps)
    assert np.isnan(ways["corner", "gradient", "a tenth"].seconds)
    assert np.isfinite(ways["corner", "gradient", "ten times"].seconds)
