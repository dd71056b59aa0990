"""Scenes that break a tracker: found within bounds, judged anew, kept in a file."""

import functools
import json

import jax
import jax.numpy as jnp
import numpy as np
import optax
import pytest

from jaxtrack.io import DataError
from jaxtrack.montecarlo import monte_carlo
from jaxtrack.tuning import (
    falsify,
    read_regression_scenes,
    uniform_scene,
    write_regression_scenes,
)
from tests.tuning import fading_crossings

LOW, HIGH = {"x": jnp.array([0.0, -2.0]), "y": 1.0}, {"x": jnp.array([1.0, 2.0]), "y": 3.0}
MIDDLE = np.array([0.8, 1.0])


def hill(scene, key):
    """A hill within the bounds in x, a slope in y."""
    top = jnp.asarray(MIDDLE, scene["x"].dtype) + 0.01 * jax.random.normal(key, (2,))
    return scene["y"] - 4.0 * ((scene["x"] - top) ** 2).sum()


def height(scene, key):
    return {"height": hill(scene, key), "high": (hill(scene, key) > 2.0).astype(float)}


SIZES = {"starts": 3, "steps": 80, "batch": 4, "holdout": 16, "verify": 64}


def run(**changes):
    arguments = {"low": LOW, "high": HIGH, "key": jax.random.key(1)} | SIZES | changes
    low, high = arguments.pop("low"), arguments.pop("high")
    verdict = arguments.pop("verdict", height)
    return falsify(hill, verdict, low, high, optax.adam(0.2), **arguments)


@functools.cache
def found():
    return run()


def test_it_climbs_from_random_starts_and_stays_within_the_bounds():
    result = found()
    assert result.scenes["x"].shape == result.start["x"].shape == (3, 2)
    np.testing.assert_allclose(result.scenes["x"], np.tile(MIDDLE, (3, 1)), atol=0.05)
    assert ((result.scenes["y"] > 2.9) & (result.scenes["y"] <= 3.0)).all()
    for tree in (result.scenes, result.start):
        for name, value in tree.items():
            assert ((value >= np.asarray(LOW[name])) & (value <= np.asarray(HIGH[name]))).all()
    assert len(np.unique(result.start["y"])) == 3
    np.testing.assert_allclose(result.loss, 3.0, atol=0.1)


def test_the_verdict_is_of_fresh_realizations_and_the_worst_comes_first():
    result = found()
    assert result.realizations == 64
    assert (np.diff(result.score["height"]) <= 0).all()
    # Means over the same fresh keys: nothing but the scenes differs.
    np.testing.assert_allclose(result.score["height"], 3.0, atol=0.1)
    assert (result.score["height"] != result.loss).all()
    assert (result.score["high"] == 1.0).all()
    # Over the box: E y = 2, E |x − top|² = 1/12 + .09 + 16/12 + 1.
    expected = 2.0 - 4.0 * (1 / 12 + 0.3**2 + 16 / 12 + 1.0)
    error = result.ordinary_error["height"]
    assert abs(result.ordinary["height"] - expected) < 4 * error
    assert 0 < error < 2.0


def test_it_is_the_same_again_and_another_with_another_key():
    again, other = run(), run(key=jax.random.key(2))
    jax.tree.map(np.testing.assert_array_equal, again, found())
    assert (other.start["y"] != again.start["y"]).all()


def test_ordinary_scenes_fill_the_bounds():
    keys = jax.random.split(jax.random.key(0), 500)
    scenes = jax.vmap(lambda key: uniform_scene(key, LOW, HIGH))(keys)
    for name, low, high in (("y", 1.0, 3.0), ("x", LOW["x"], HIGH["x"])):
        np.testing.assert_allclose(scenes[name].min(0), low, atol=0.05)
        np.testing.assert_allclose(scenes[name].max(0), high, atol=0.05)
    assert abs(np.corrcoef(np.c_[scenes["x"], scenes["y"]].T) - np.eye(3)).max() < 0.2


def test_what_cannot_be_is_named():
    with pytest.raises(ValueError, match=r"high\['y'\]: got 1.0, want more than low"):
        run(high=HIGH | {"y": 1.0})
    with pytest.raises(ValueError, match="high: got the structure"):
        run(high={"x": HIGH["x"]})
    with pytest.raises(ValueError, match=r"high\['x'\]: got shape"):
        run(high=HIGH | {"x": 3.0})
    with pytest.raises(TypeError, match="verdict: got NoneType, want a function"):
        run(verdict=None)
    with pytest.raises(ValueError, match=r"verdict: got shape \[2\]"):
        run(verdict=lambda scene, key: scene["x"])
    with pytest.raises(ValueError, match="starts: got 0, want an int ≥ 1"):
        run(starts=0)


def test_a_file_gives_back_what_was_found(tmp_path):
    file = tmp_path / "scenes.json"
    write_regression_scenes(file, found(), about="a hill")
    score = {"height": 0.0, "high": 0.0}
    again = read_regression_scenes(file, scene=LOW, score=score)
    jax.tree.map(np.testing.assert_array_equal, again, found())
    content = json.loads(file.read_text())
    assert content["about"] == "a hill"
    assert content["scenes"][0]["params"]["y"] == found().scenes["y"][0]
    with pytest.raises(ValueError, match=r"got the names \['x', 'y'\], want \['x'\]"):
        read_regression_scenes(file, scene={"x": 0.0}, score=score)
    none = json.dumps(content | {"scenes": []})
    half = json.dumps({"format": content["format"]})
    for text, reason in (
        ("{}", "want a file whose format is"),
        ("{", "want JSON"),
        (none, "scenes: got none"),
        (half, "'scenes' is missing"),
    ):
        file.write_text(text)
        with pytest.raises(DataError, match=reason):
            read_regression_scenes(file, scene=LOW, score=score)


def kept():
    return read_regression_scenes(
        fading_crossings.FILE, scene=fading_crossings.LOW, score=fading_crossings.SCORE
    )


def worst_again(key, scene):
    return fading_crossings.verdict(scene, key)


@pytest.mark.slow
def test_the_kept_scene_breaks_the_tracker_as_often_as_is_written():
    known = kept()
    worst = jax.tree.map(lambda x: x[0], known.scenes)
    again = monte_carlo(worst_again, jax.random.key(77), 240, worst, micro_batch=8)
    for name, mean in again.mean.items():
        error = np.hypot(again.standard_error[name], known.score_error[name][0])
        assert abs(mean - known.score[name][0]) < 4 * error, name
    error = np.hypot(again.standard_error["broken"], known.ordinary_error["broken"])
    assert again.mean["broken"] > known.ordinary["broken"] + 5 * error


@pytest.mark.slow
def test_other_starts_find_a_scene_that_is_far_from_ordinary():
    other = fading_crossings.find(key=jax.random.key(5), starts=4, steps=40, verify=500)
    error = np.hypot(other.score_error["broken"], other.ordinary_error["broken"])
    # Not every start climbs to one: what is lost at once has no slope.
    assert other.score["broken"][0] > other.ordinary["broken"] + 5 * error[0]
    known = kept()
    error = np.hypot(other.ordinary_error["broken"], known.ordinary_error["broken"])
    assert abs(other.ordinary["broken"] - known.ordinary["broken"]) < 4 * error
