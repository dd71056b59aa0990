import io
import itertools
import json

import jax
import jax.numpy as jnp
import numpy as np
import pytest
import xarray as xr
from rich.console import Console

from jaxtrack.models import BEAMS
from jaxtrack.sensors import Echo
from jaxtrack.sensors.echoes import echo_amplitudes
from jaxtrack.studies import STUDIES, Context, store, tables
from jaxtrack.studies.learn import sensitivity, weights, weights_report, weights_trial
from jaxtrack.studies.learn.echoes import DEGREES, echo_log_ratio
from jaxtrack.types import BeamScan, Pose
from tests.metrics.differences import assert_gradients_agree
from tests.oracles import echoes as oracle

simulate = jax.jit(weights_trial.simulate)


@pytest.mark.parametrize("amplitude", [(0.4, 1.5), (2.0, 1.5), (0.05, 0.9)])
def test_the_ratio_is_that_of_an_integral_over_the_textures(amplitude):
    echo, share = Echo(1.0, 12.0), 0.1
    ratio = jax.jit(echo_log_ratio)(jnp.array([amplitude]), jnp.ones((1, 2), bool), echo, share)
    expected = [oracle.log_ratio(*pair, *echo, share) for pair in (amplitude, amplitude[::-1])]
    np.testing.assert_allclose(ratio[0], expected, atol=0.05)


@pytest.mark.slow
def test_a_silent_beam_is_a_gap_in_the_chain():
    amplitude = jnp.array([[0.4, jnp.nan, 1.5]])
    mask = jnp.array([[True, False, True]])
    ratio = echo_log_ratio(amplitude, mask, Echo(1.0, 12.0), 0.1)
    # Two beams on, the correlation is that of neighbours half as far correlated.
    near = echo_log_ratio(amplitude[:, ::2], mask[:, ::2], Echo(1.0, 6.0), 0.1)
    assert ratio[0, 1] == 0
    np.testing.assert_allclose(ratio[0, ::2], near[0], atol=0.05)


def test_the_odds_it_gives_are_those_of_the_draws():
    key, share, echo = jax.random.key(0), 0.1, Echo(1.0, 12.0)
    is_target = jax.random.uniform(key, (4000, 32)) < share
    loud = echo_amplitudes(jax.random.key(1), is_target, echo, degrees=DEGREES, dtype=jnp.float32)
    ratio = jax.jit(echo_log_ratio)(loud, jnp.ones_like(is_target), echo, share)
    odds = np.asarray(ratio) + np.log(share / (1 - share))
    probability, label = 1 / (1 + np.exp(-odds)).ravel(), np.asarray(is_target).ravel()
    edges = np.quantile(probability, [0, 0.5, 0.8, 0.9, 0.95, 0.99, 1])
    for low, high in itertools.pairwise(edges):
        some = (probability >= low) & (probability <= high)
        share_of_it, stated = label[some].mean(), probability[some].mean()
        error = np.sqrt(stated * (1 - stated) / some.sum())
        assert abs(share_of_it - stated) < 5 * error + 0.004


def test_weights_are_bounded_odds_and_masked_echoes_weigh_nothing():
    window = simulate(jax.random.key(0))
    ratio = jnp.where(window.scans.mask, jnp.log(3.0), jnp.nan)
    scans, sensor = weights_trial.weighted(window.scans, ratio, 9.0)
    np.testing.assert_allclose(scans.weight, jnp.where(window.scans.mask, 0.25, 0.0))
    assert sensor.sonar.p_false == pytest.approx(0.1)


def plain(arrays, scans):
    """Two numbers in place of a network: how much loudness counts, and a constant."""
    return arrays[0] * jnp.log(jnp.where(scans.mask, scans.intensity, 1.0) + 0.1) + arrays[1]


def test_the_loss_of_labels_is_smooth_in_what_is_trained():
    loss, key = weights_trial.label_loss(plain), jax.random.key(2)
    of = lambda x: loss({"network": x}, key)
    (slope,) = assert_gradients_agree(of, np.array([1.0, 0.3]), rtol=1e-5)
    assert np.abs(slope).max() > 1e-3


def test_labels_teach_the_ratio_at_a_place_not_how_far_off_targets_are():
    def ratio(tilt, scans):
        far = jnp.log(jnp.maximum(scans.range_m, 1.0) / 75.0)
        return weights_trial.true_log_ratio(scans) + jnp.where(scans.mask, tilt * far, 0.0)

    loss = weights_trial.label_loss(ratio)
    slope = jax.grad(lambda tilt, key: loss({"network": tilt}, key))
    keys = jax.random.split(jax.random.key(4), 400)
    both = jax.jit(jax.vmap(jax.vmap(slope, (None, 0)), (0, None)))(jnp.arange(2.0), keys)
    once, once_more = np.asarray(both)
    error = once.std() / np.sqrt(len(keys))
    assert abs(once.mean()) < 4 * error
    # Far enough from how it is where the range counts once more.
    assert once_more.mean() > 10 * error


@pytest.mark.slow
def test_the_loss_of_tracks_is_smooth_in_what_is_trained(monkeypatch):
    key = jax.random.key(2)
    # Which trajectory is the rival, and where samples stand, is held fixed in the gradient.
    window = simulate(key)
    at = weights_trial.weighted(window.scans, plain(jnp.array([1.0, 0.3]), window.scans), 10)
    rival = weights_trial._rival(*at, window.truth.state[-1])
    assert rival[1]
    monkeypatch.setattr(weights_trial, "_rival", lambda *_: rival)
    score = lambda state, scans, sensor, *_, observation, **__: (
        None, None, observation.scores(state[None], scans, sensor)[0]
    )  # fmt: skip
    monkeypatch.setattr(weights_trial.joint, "evidence", score)
    tracks = weights_trial.track_loss(plain)
    of = lambda x: tracks({"network": x[:2], "gate": x[2]}, key)
    (slope,) = assert_gradients_agree(of, np.array([1.0, 0.3, 9.0]), rtol=1e-5)
    assert np.abs(slope).max() > 1e-2


@pytest.mark.slow
def test_the_rival_is_no_target_and_the_best_of_what_is_left():
    window = simulate(jax.random.key(3))
    ratio = weights_trial.true_log_ratio(window.scans)
    scans, sensor = weights_trial.weighted(window.scans, ratio, 10.0)
    truth = window.truth.state[-1]
    state, there = jax.jit(weights_trial._rival)(scans, sensor, truth)
    assert there
    span = scans.time_s[0] - scans.time_s[-1]
    far = lambda ago: jnp.linalg.norm(
        (state[:2] + ago * state[2:])[None] - (truth[:, :2] + ago * truth[:, 2:]), axis=-1
    )
    assert (jnp.maximum(far(0.0), far(span)) >= 15.0).all()
    score = BEAMS.scores(jnp.stack([state, *truth]), scans, sensor)
    assert score[0] > 0  # clutter that happens to lie on a line
    # Without any detection there is no rival.
    silent = scans._replace(mask=jnp.zeros_like(scans.mask))
    assert not jax.jit(weights_trial._rival)(silent, sensor, truth)[1]


def test_what_a_network_sees_ignores_what_is_masked_and_starts_with_equal_weights():
    pytest.importorskip("flax")
    from jaxtrack.studies.learn.network import echo_network, features_of

    mask = jnp.array([[True, False, True, True]])
    pose = Pose(jnp.zeros((1, 2)), jnp.zeros(1))
    scans = lambda junk: BeamScan(
        jnp.zeros(1), jnp.ones(1, bool), jnp.array([[20.0, junk, 70.0, 3.0]]), mask, pose,
        intensity=jnp.array([[0.3, junk, 0.0, 2.0]]),
    )  # fmt: skip
    seen = features_of(scans(jnp.nan), 150.0)
    np.testing.assert_array_equal(seen, features_of(scans(7.0), 150.0))
    assert np.isfinite(seen).all()
    params, network = echo_network(jax.random.key(0))
    np.testing.assert_array_equal(network(params, seen), np.zeros((1, 4)))
    params["out"]["kernel"] += 1.0
    assert np.ptp(network(params, seen)) > 0


def made_up(best=2.0, ceiling=1.0, tracks=1.2, labels=1.3, trials=400):
    """Scores of which setting and gate 1 are the best on the scenes for choosing."""
    settings = weights_trial.settings(2)
    level = {"threshold": best, "ceiling": ceiling, "tracks": tracks, "labels": labels}
    shape = len(settings), len(weights_trial.GATES)
    ospa = np.full((trials, *shape), 9.0)
    for place, (method, _, value) in enumerate(settings):
        if value in (weights_trial.THRESHOLDS[1], weights_trial.BOOSTS[1]):
            ospa[:, place, 1] = level[method]
    noise = np.random.default_rng(0).normal(size=(trials, 1, 1))
    return xr.Dataset(
        {
            "ospa": (("trial", "setting", "gate"), ospa + 0.1 * noise),
            "ospa_choosing": (("scene", "setting", "gate"), ospa[:3]),
        },
        coords={
            "method": ("setting", [method for method, _, _ in settings]),
            "network": ("setting", [n for _, n, _ in settings]),
            "value": ("setting", [x for _, _, x in settings]),
            "gate": list(weights_trial.GATES),
        },
    )


def verdicts(scores):
    rows = weights_report.marks(scores)
    return {row.what: (row.ours.value, tables.verdict(row.ours, row.mark)) for row in rows}


def test_settings_are_chosen_on_other_scenes_and_the_gap_is_closed_in_shares():
    chosen = weights_report.chosen(made_up())
    assert chosen["threshold"].values == [weights_trial.THRESHOLDS[1]]
    assert chosen["tracks"].gates == [weights_trial.GATES[1]] * 2
    assert chosen["tracks"].ospa_m.shape == (2, 400)
    words = verdicts(made_up())
    assert words["share closed, trained through the joint vote"] == (pytest.approx(0.8), "pass")
    assert words["OSPA on labels alone above that through the joint vote"][0] == pytest.approx(0.1)
    few = verdicts(made_up(tracks=1.5))
    assert few["share closed, trained through the joint vote"] == (pytest.approx(0.5), "fails")
    smoke = verdicts(made_up(trials=19))
    assert smoke["share closed, trained through the joint vote"][1] == "smoke"
    table = weights_report.table(made_up())
    assert list(table.columns[3].cells) == ["", ".000", ".700", ".800", "1"]


@pytest.mark.slow
def test_scores_of_the_specification_are_slopes_of_the_density_and_mean_nothing():
    spec = sensitivity.Specification(3.0, 0.05, 0.3, 0.4)
    draws = sensitivity.draw(jax.random.key(0))
    seen = sensitivity.report(draws, spec)

    def density(x):
        return sensitivity.log_density(draws, seen, sensitivity.Specification(*x))

    assert_gradients_agree(density, np.array(spec), rtol=1e-5)

    def one(key):
        draws = sensitivity.draw(key)
        seen = sensitivity.report(draws, spec)
        of = lambda spec: sensitivity.log_density(draws, seen, spec)
        slope = jnp.stack(jax.grad(of)(jax.tree.map(jnp.asarray, spec)))
        noise = jnp.where(seen.hit, (spec.sigma_m * draws.noise[..., 0]) ** 2, 0.0)
        count = lambda x: x.sum(dtype=float)
        counted = jnp.stack([noise.sum(), count(seen.hit), count(seen.alarm)])
        return slope, counted, count(draws.truth.mask)

    run = jax.jit(jax.vmap(one))(jax.random.split(jax.random.key(1), 2000))
    slope, counted, looks = map(np.asarray, run)
    error = slope.std(0) / np.sqrt(len(slope))
    assert (np.abs(slope.mean(0)) < 4 * error).all()
    # What the score function says of means that are known.
    each = (counted - counted.mean(0))[:, :, None] * slope[:, None, :]
    found, error = each.mean(0), each.std(0) / np.sqrt(len(each))
    hits = float(looks.mean()) * 0.7
    expected = {(0, 0): 2 * 3.0 * hits, (1, 2): -float(looks.mean()), (2, 3): 12 * 16.0}
    for place, value in expected.items():
        assert abs(found[place] - value) < 4 * error[place]
    assert abs(found[2, 2]) < 4 * error[2, 2]  # false alarms do not know P_M


def test_without_flax_it_says_so_and_writes_nothing(tmp_path, monkeypatch):
    monkeypatch.setattr(weights, "is_installed", lambda: False)
    screen = io.StringIO()
    context = Context(tmp_path, 2, 7, Console(file=screen, width=160), lambda *_: None)
    STUDIES["learn_weights"].run(context)
    assert "Flax is not installed" in screen.getvalue()
    assert list(tmp_path.iterdir()) == []


@pytest.mark.slow
def test_a_tiny_run_writes_all_its_files_and_gives_no_verdict(tmp_path):
    pytest.importorskip("flax")
    screen = io.StringIO()
    context = Context(tmp_path, 2, 7, Console(file=screen, width=160), lambda *_: None)
    STUDIES["learn_weights"].run(context)
    text = screen.getvalue()
    assert "smoke" in text
    assert "pass" not in text
    assert "fails" not in text
    groups, summary = store.load(tmp_path)
    assert list(groups) == ["scores", "sensitivity"]
    assert np.isfinite(groups["scores"].ospa_choosing).all()
    chosen = weights_report.choices(groups["scores"])
    scored = {setting for places in chosen.values() for setting, _ in places}
    held_out = np.isfinite(groups["scores"].ospa).all(axis=(0, 2))
    assert set(np.flatnonzero(held_out)) == scored
    assert {row["verdict"] for row in summary["marks"]} == {"smoke", ""}
    json.dumps(summary, allow_nan=False)
    assert len(list(tmp_path.glob("*.png"))) == 3
    assert not (tmp_path / "parts").exists()
