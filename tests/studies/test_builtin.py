"""The built-in scenes, methods and metrics, on scenes whose answers are known."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from jaxtrack.models import line_through
from jaxtrack.studies import builtin
from jaxtrack.types import Lines, Tracks


@pytest.fixture(scope="module")
def looks():
    scene = lambda key: builtin.crossing_targets(key, sigma_m=0.0, clutter_per_scan=0.0)
    return jax.jit(scene)(jax.random.key(0))


@jax.jit
def counts(looks, estimate):
    """Return targets found, false lines, and whether all is perfect."""
    names = ("targets_found", "false_lines", "perfect")
    return [builtin.METRICS[name](looks, estimate) for name in names]


def lines_of_truth(looks, keep):
    place = looks.truth.state[..., :2]
    rho, theta = line_through(place[0], place[-1], jnp.zeros(2))
    return Lines(rho, theta, jnp.full(3, 6.0), jnp.asarray(keep))


def tracks_of_truth(looks, shift_m, keep):
    mean = looks.truth.state[-1] + jnp.array([shift_m, 0.0, 0.0, 0.0])[None]
    some = jnp.ones(3)
    mask = jnp.asarray(keep)
    return Tracks(looks.truth.time_s[-1], mean, jnp.zeros((3, 4, 4)), mask, some, some, some, some)


def test_lines_of_the_truth_are_found(looks):
    for keep in ([True, True, True], [True, False, True]):
        lines = lines_of_truth(looks, keep)
        assert counts(looks, lines) == [sum(keep), 0, all(keep)]
    astray = lines._replace(rho_m=lines.rho_m + 400.0)
    assert counts(looks, astray) == [0, 2, False]


def test_tracks_count_as_the_lines_that_they_move_on(looks):
    tracks = tracks_of_truth(looks, 0.0, [True, True, False])
    assert counts(looks, tracks) == [2, 0, False]
    negative = tracks._replace(log_score=-tracks.log_score)  # what a negative gate lets through
    assert counts(looks, negative) == [2, 0, False]


def test_ospa_is_that_of_the_last_look(looks):
    ospa = jax.jit(lambda *at: builtin.ospa(*at[:2], cutoff_m=at[2]))
    distance = lambda keep, cutoff_m: float(
        ospa(looks, tracks_of_truth(looks, 30.0, keep), cutoff_m)
    )
    assert distance([True] * 3, 100.0) == pytest.approx(30.0)
    assert distance([True, True, False], 100.0) == pytest.approx((30 + 30 + 100) / 3)
    assert distance([True] * 3, 20.0) == pytest.approx(20.0)


def test_random_targets_are_new_ones_each_trial():
    sizes = {"targets": 2, "looks": 4, "detections": 8}
    scene = jax.jit(lambda key: builtin.random_targets(key, sigma_m=0.0, **sizes))
    one, other = scene(jax.random.key(0)), scene(jax.random.key(1))
    assert one.truth.state.shape == (4, 2, 4)
    assert one.scans.position_m.shape == (4, 8, 2)
    assert not np.allclose(one.truth.state, other.truth.state)


@pytest.mark.parametrize("name", list(builtin.METHODS))
def test_methods_give_what_metrics_take(looks, name):
    gate = 18.0 if name == "joint" else 3.0
    sizes = {} if name == "joint" else {"rho": 40, "theta": 30, "pairs": 1024}
    shape = jax.eval_shape(lambda at: builtin.METHODS[name](at, gate=gate, **sizes), looks)
    assert type(shape) is (Tracks if name == "joint" else Lines)
    for metric in ("targets_found", "false_lines", "perfect"):
        assert jax.eval_shape(builtin.METRICS[metric], looks, shape).shape == ()
