"""What the studies of tuning share, on a bowl; and the two whose score is OSPA."""

import functools
import io
import json

import jax
import jax.numpy as jnp
import numpy as np
import pytest
import xarray as xr
from rich.console import Console

from jaxtrack.numerics import positive
from jaxtrack.studies import STUDIES, Context, store, tables
from jaxtrack.studies.tuned import csht_trial, report, tpe, tracker_trial
from jaxtrack.studies.tuned import study as tuned
from jaxtrack.studies.tuned.ways import Case, Score, case_around, tune_all
from tests.metrics.differences import assert_gradients_agree

TINY = {"a fifth": 0.2, "five times": 5.0}
WORDS = report.Words({"bowl": "A bowl"}, {"x": ("x", "m"), "y": ("y", "")}, {}, ("far, m",), "m")
EFFORT = tuned.SMOKE._replace(steps=40, batch=4, holdout=8, every=10)


def away(params, key):
    # The least is elsewhere each time: so differences between settings have an error.
    x, y = jnp.log(params["x"] / 3.0), jnp.log(params["y"] / 0.5)
    off = 0.3 * jax.random.normal(key, (2,))
    return (x + off[0]) ** 2 + (y + off[1]) ** 2


def counted(params, key):
    return Score(away(params, key)[None], jnp.asarray(False))


CASES = {
    "bowl": Case(
        away,
        counted,
        {"by hand": {"x": 4.0, "y": 0.5}},
        {start: {"x": 3.0 * f, "y": 0.5 * f} for start, f in TINY.items()},
        {"x": (0.1, 100.0), "y": (0.01, 10.0)},
        positive(),
        ("x", "y"),
    )
}


def context_in(folder, trials=30, progress=lambda *_: None, screen=None):
    console = Console(file=screen, width=200) if screen else Console(quiet=True)
    return Context(folder, trials, 7, console, progress)


def run(context, effort=EFFORT):
    marks = functools.partial(report.marks, words=WORDS)
    tuned.run_study(context, STUDIES["tune_tracker"], effort, CASES, WORDS, marks)
    return store.load(context.out)


@pytest.mark.parametrize("installed", [pytest.param(True, marks=pytest.mark.slow), False])
def test_a_run_tunes_scores_draws_and_leaves_no_parts(tmp_path, monkeypatch, installed):
    if installed:
        pytest.importorskip("optuna")
    else:
        monkeypatch.setattr(tpe, "is_installed", lambda: False)
    screen = io.StringIO()
    groups, summary = run(context_in(tmp_path, screen=screen))
    assert ("Optuna is not installed" in screen.getvalue()) is not installed
    assert list(groups) == ["scores", "map, bowl"]
    scores = groups["scores"]
    methods = ["gradient", "TPE", "TPE on the score"] if installed else ["gradient"]
    assert list(scores.tuner.values) == methods
    assert scores.sizes["trial"] == 30
    ends = scores.params_on_the_way.sel(case="bowl", tuner="gradient").isel(evaluation=-1)
    np.testing.assert_allclose(ends, [[3.0, 0.5]] * 2, rtol=0.2)
    assert list(scores.realizations.values) == [8, 56, 104, 152, 200]
    loss = groups["map, bowl"].loss
    assert loss.dims == ("x", "y")
    assert np.isfinite(loss).all()
    words = {row["what"]: row["verdict"] for row in summary["marks"]}
    assert [word for what, word in words.items() if "above the best" in what] == ["pass"] * 2
    assert {"map_bowl.png", "fit_bowl.png", "score_by_realizations.png"} == {
        file.name for file in tmp_path.glob("*.png")
    }
    assert not (tmp_path / "parts").exists()


def test_an_interrupted_run_goes_on_where_it_was(tmp_path, monkeypatch):
    monkeypatch.setattr(tpe, "is_installed", lambda: False)
    whole, _ = tune_all(context_in(tmp_path / "whole"), EFFORT, CASES)

    def stop(what, done, total):
        if (what, done) == ("gradient, bowl, five times", 23):
            raise KeyError

    with pytest.raises(KeyError):
        tune_all(context_in(tmp_path, progress=stop), EFFORT, CASES)
    seen = []
    ways, _ = tune_all(context_in(tmp_path, progress=lambda *at: seen.append(at)), EFFORT, CASES)
    assert seen[0] == ("gradient, bowl, five times", 21, 40)
    for name, way in whole.items():
        np.testing.assert_array_equal(ways[name].steps, way.steps)
        np.testing.assert_array_equal(ways[name].best, way.best)
    assert all(np.isnan(way.seconds) for way in ways.values())
    assert all(np.isfinite(way.seconds) for way in whole.values())


def made_up(fifth, five, default=5.0, trials=400):
    """Scores of a default and of two tunings, on the same scenes."""
    settings = ["by hand", *(f"gradient, {start}" for start in TINY)]
    scenes = np.random.default_rng(0).normal(size=(trials, 1))
    own = np.random.default_rng(1).normal(scale=0.2, size=(trials, 3))
    score = scenes + own + np.array([default, fifth, five])
    return xr.Dataset(
        {"score": (("case", "trial", "setting", "measure"), score[None, ..., None])},
        coords={
            "case": ["bowl"], "setting": settings, "tuner": ["gradient"], "start": list(TINY),
        },
    )  # fmt: skip


@pytest.mark.parametrize(
    ("means", "words"), [((4.0, 4.0), ["pass", "pass"]), ((4.0, 4.2), ["pass", "fails"])]
)
def test_a_tuning_passes_within_three_standard_errors_of_the_best(means, words):
    rows = report.near_best(made_up(*means), "bowl", WORDS)
    assert [tables.verdict(row.ours, row.mark) for row in rows[:2]] == words
    for row, mean in zip(rows[2:], means, strict=True):  # what is gained on the default
        assert row.ours.value == pytest.approx(5.0 - mean, abs=0.06)
        assert row.ours.upper - row.ours.lower < 0.06
        assert row.ours.unit == "m"


def test_a_search_spends_what_a_fit_does_and_returns_the_best_that_was_held_out():
    pytest.importorskip("optuna")

    def bowl(params, key, realizations):
        assert realizations in (4, 8)
        return np.log(params["x"] / 3.0) ** 2 + 0.01 * jax.random.normal(key) / realizations

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
@pytest.mark.parametrize(("trial", "key"), [(csht_trial, 1), (tracker_trial, 5)])
def test_losses_are_smooth_in_all_that_is_tuned(trial, key):
    default = trial.hand()

    def of_logs(free):
        return trial.loss(dict(zip(default, jnp.exp(free), strict=True)), jax.random.key(key))

    start = np.log([1.05 * value for value in default.values()])
    (gradient,) = assert_gradients_agree(of_logs, start, rtol=1e-5, atol=1e-8)
    assert (np.abs(gradient) > 0).all()


def test_starts_are_factors_of_the_defaults_and_shares_stay_below_one():
    default = {"x": 3.0, "share": 0.3}
    case = case_around("by hand", default, away, counted, ("x", "share"), shares=("share",))
    assert case.hand == {"by hand": default}
    assert case.starts == {
        "a fifth": {"x": pytest.approx(0.6), "share": pytest.approx(0.06)},
        "five times": {"x": 15.0, "share": 0.95},
    }
    assert case.bounds == {"x": pytest.approx((0.3, 30.0)), "share": pytest.approx((0.03, 0.95))}
    free = case.bijectors["share"].forward(jnp.asarray(9.0))
    assert 0.99 < free < 1.0


@pytest.mark.slow
@pytest.mark.parametrize("name", ["tune_csht", "tune_tracker", "tune_nht"])
def test_a_short_run_writes_all_its_files_and_gives_no_verdict(tmp_path, monkeypatch, name):
    monkeypatch.setattr(tpe, "is_installed", lambda: False)
    screen = io.StringIO()
    STUDIES[name].run(context_in(tmp_path, trials=2, screen=screen))
    text = screen.getvalue()
    assert "smoke" in text
    assert "pass" not in text
    assert "fails" not in text
    _, summary = store.load(tmp_path)
    assert {row["verdict"] for row in summary["marks"]} == {"smoke", ""}
    json.dumps(summary, allow_nan=False)
    assert list(tmp_path.glob("map_*.png"))
