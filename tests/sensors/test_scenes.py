"""The scenes: the paper's tables, its situations, and the limits of random ones."""

import itertools
import math

import jax
import numpy as np
import pytest

from jaxtrack.sensors import (
    SITUATIONS,
    Radar,
    SceneLimits,
    crossing_targets,
    radar_measurements,
    random_targets,
)
from tests.oracles import lines
from tests.oracles.joint import moved

# Table 3 of the neutrosophic Hough transform (2018), target by target.
TABLE_3 = [
    [(-23793, 24841), (-21011, 25246), (-18300, 25575), (-15547, 25858), (-12823, 26185),
     (-10050, 26402), (-7248, 26643)],
    [(-2548, 21411), (-5080, 20251), (-7720, 19125), (-10322, 17938), (-12766, 16739),
     (-15310, 15467), (-17794, 14169)],
    [(-7021, 14156), (-8675, 16448), (-10248, 18720), (-11849, 21086), (-13363, 23508),
     (-14961, 25823), (-16459, 28155)],
]  # fmt: skip


def test_radar_measurements_are_those_of_table_3():
    scene = radar_measurements(sigma_m=3.0, clutter_per_scan=7.0)
    np.testing.assert_array_equal(scene.truth.time_s, 10.0 * np.arange(7))
    position = np.asarray(scene.truth.state[..., :2])
    np.testing.assert_array_equal(position.transpose(1, 0, 2), TABLE_3)
    assert scene.truth.mask.all()
    assert (scene.radar.sigma_m, scene.radar.clutter_per_scan) == (3.0, 7.0)
    low, high = scene.radar.field_low_m, scene.radar.field_high_m
    assert (position >= low).all()
    assert (position <= high).all()
    # Equation 20's speeds hold for the paper's own targets.
    speed = np.linalg.norm(np.diff(position, axis=0), axis=-1) / 10.0
    assert ((speed > 100.0) & (speed < 400.0)).all()
    velocity = np.asarray(scene.truth.state[..., 2:])
    np.testing.assert_allclose(velocity[3], (position[4] - position[2]) / 20.0)


@pytest.mark.parametrize("situation", SITUATIONS)
def test_crossing_targets_are_those_of_table_1(situation):
    scene = crossing_targets(situation, clutter_per_scan=12.0)
    table_1 = [(300, 400, 280, 49), (3000, 300, -173.2, 100), (2100, 1300, -173.2, -100)]
    for target, k in itertools.product(range(3), range(7)):
        expected = moved(table_1[target], 2.0 * k)
        np.testing.assert_allclose(scene.truth.state[k, target], expected, rtol=1e-12)
    np.testing.assert_array_equal(scene.truth.time_s, 2.0 * np.arange(7))
    noise, clutter = {"I": (0, 0), "II": (10, 0), "III": (0, 12), "IV": (10, 12)}[situation]
    assert (scene.radar.sigma_m, scene.radar.clutter_per_scan) == (noise, clutter)
    assert scene.radar.p_detect == 0.99
    position = np.asarray(scene.truth.state[..., :2])
    assert (position >= 0.0).all()
    assert (position <= (3700.0, 1600.0)).all()


def test_an_unknown_situation_is_refused():
    with pytest.raises(ValueError, match="situation: got 'V'"):
        crossing_targets("V")


draw = jax.jit(
    jax.vmap(lambda key, limits: random_targets(key, Radar(), limits, targets=3), (0, None))
)


def test_random_scenes_keep_to_their_limits_where_they_say_so():
    radar, limits = Radar(), SceneLimits()
    truth, within = draw(jax.random.split(jax.random.key(0), 500), limits)
    within = np.asarray(within)
    assert 0.5 < within.mean() < 1.0
    state = np.asarray(truth.state)[within]
    assert state.shape[1:] == (7, 3, 4)
    np.testing.assert_array_equal(truth.time_s[0], 2.0 * np.arange(7))

    straight = state[:, :1, :, :2] + 2.0 * np.arange(7)[:, None, None] * state[:, :1, :, 2:]
    np.testing.assert_allclose(state[..., :2], straight, atol=1e-9)
    speed = np.linalg.norm(state[..., 2:], axis=-1)
    assert speed.min() >= limits.v_min_m_s - 1e-9
    assert speed.max() <= limits.v_max_m_s + 1e-9
    margin = float(limits.margin_m) - 1e-6
    assert (state[..., :2] >= np.array(radar.field_low_m) + margin).all()
    assert (state[..., :2] <= np.array(radar.field_high_m) - margin).all()

    apart = []
    for scene in np.asarray(truth.state):
        line = [lines.line_through(s[:2], s[:2] + s[2:], (0.0, 0.0)) for s in scene[0]]
        differences = [lines.difference(*p, *q) for p, q in itertools.combinations(line, 2)]
        apart.append(all(abs(r) > 150.0 or abs(t) > 0.15 for r, t in differences))
    assert np.array(apart)[within].all()
    assert not np.array(apart).all()


def test_random_scenes_differ_and_have_headings_all_around():
    truth, _ = draw(jax.random.split(jax.random.key(1), 500), SceneLimits())
    assert len(np.unique(truth.state[:, 0, 0, 0])) == 500
    velocity = np.asarray(truth.state[:, 0, :, 2:]).reshape(-1, 2)
    heading = np.arctan2(velocity[:, 1], velocity[:, 0])
    count, _ = np.histogram(heading, bins=8, range=(-math.pi, math.pi))
    assert count.min() > 50


def test_limits_that_no_target_keeps_lower_the_flag():
    limits = SceneLimits(v_min_m_s=1e5, v_max_m_s=1e6)
    truth, within = draw(jax.random.split(jax.random.key(0), 500), limits)
    assert not within.any()
    assert np.isfinite(truth.state).all()
