"""The paper's scenes against its numbers, and the limits of random ones."""

import itertools

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from jaxtrack.models import BeamSonar
from jaxtrack.sensors import (
    SonarSceneLimits,
    in_sight,
    motion_elements_scene,
    observe_beams,
    random_sonar_scene,
    tracking_scene,
)
from tests.oracles import frames

SECTOR, SCOPE_M = np.pi / 2, 150.0


def test_three_targets_are_those_of_table_2_and_in_sight_throughout():
    truth, pose, sonar = motion_elements_scene()
    table_2 = [((10, 80), (1, 4)), ((20, 30), (-2, 1)), ((50, 60), (3, -3))]
    assert truth.state.shape == (20, 3, 4)
    assert truth.mask.all()
    for k in range(20):
        vehicle = -10 + 0.5 * 0.5 * k, -10 + 0.5 * 0.5 * k
        np.testing.assert_allclose(truth.time_s[k], 0.5 * k)
        np.testing.assert_allclose(pose.position_m[k], vehicle, atol=1e-12)
        np.testing.assert_allclose(pose.heading_rad[k], np.deg2rad(45))
        for target, (place, velocity) in enumerate(table_2):
            now = [p + 0.5 * k * v for p, v in zip(place, velocity, strict=True)]
            np.testing.assert_allclose(truth.state[k, target], (*now, *velocity), atol=1e-12)
            assert frames.in_sight(now, vehicle, np.deg2rad(45), SECTOR, SCOPE_M)
    assert (sonar.p_miss, sonar.p_false, sonar.sigma_m) == (0.3, 0.3, 3.0)
    assert in_sight(truth, pose, sonar).mask.all()


def spans(scene):
    """Return the first and last time of each target; none comes back after it has gone."""
    mask, time_s = np.asarray(scene.truth.mask), np.asarray(scene.truth.time_s)
    assert (np.abs(np.diff(mask.astype(int), axis=0)).sum(axis=0) <= 2).all()
    return [tuple(time_s[there][[0, -1]].tolist()) for there in mask.T]


def test_five_targets_are_those_of_table_7():
    scene = tracking_scene("table")
    table_7 = [
        ((120, 80), (-0.5, -1)), ((20, 0), (2, 0.25)), ((70, -10), (-0.25, 1.5)),
        ((200, 20), (-1.5, 0.5)), ((120, 150), (0.25, -0.75)),
    ]  # fmt: skip
    np.testing.assert_allclose(scene.truth.time_s, np.arange(1.0, 100.1, 0.5))
    for k in (0, 57, 198):
        now_s = 1 + 0.5 * k
        np.testing.assert_allclose(scene.pose.position_m[k], (0.87 * now_s, 0.5 * now_s))
        np.testing.assert_allclose(scene.pose.heading_rad[k], np.deg2rad(30))
        for target, (place, velocity) in enumerate(table_7):
            now = [p + now_s * v for p, v in zip(place, velocity, strict=True)]
            np.testing.assert_allclose(scene.truth.state[k, target], (*now, *velocity), atol=1e-11)
    assert spans(scene) == [(1, 69), (1, 100), (1, 59), (22, 88), (32, 100)]
    assert (scene.sonar.p_miss, scene.sonar.p_false, scene.sonar.sigma_m) == (0.5, 0.5, 3.0)


def test_what_is_visible_of_table_7_is_what_its_sonar_can_see():
    scene = tracking_scene("visible")
    assert spans(scene) == [(1, 60), (1, 100), (1, 52), (22, 82), (31.5, 100)]
    for k, target in itertools.product(range(199), range(5)):
        place = np.asarray(scene.truth.state[k, target, :2])
        vehicle, heading = np.asarray(scene.pose.position_m[k]), np.deg2rad(30)
        seen = frames.in_sight(place, vehicle, heading, SECTOR, SCOPE_M)
        assert scene.truth.mask[k, target] == seen


def test_both_truths_of_table_7_make_the_same_echoes_but_for_one_look():
    runs = []
    for truth in ("table", "visible"):
        scene = tracking_scene(truth)
        sonar = scene.sonar._replace(p_miss=0.0)
        runs.append(jax.jit(observe_beams)(jax.random.key(0), scene.truth, scene.pose, sonar))
    differs = (runs[0].range_m != runs[1].range_m).any(axis=1)
    assert scene.truth.time_s[differs].tolist() == [31.5]
    with pytest.raises(ValueError, match="truth: got 'printed', want one of table, visible"):
        tracking_scene("printed")


LIMITS, SONAR = SonarSceneLimits(), BeamSonar()


@jax.jit
def draw(keys, limits, count):
    return jax.vmap(
        lambda key, count: random_sonar_scene(key, SONAR, limits, targets=5, count=count)
    )(keys, count)


def test_random_scenes_keep_to_their_limits_exactly_where_they_say_so():
    count = np.arange(400) % 5 + 1
    scenes, within = draw(jax.random.split(jax.random.key(0), 400), LIMITS, jnp.asarray(count))
    within = np.asarray(within)
    assert 0.8 < within.mean() < 1.0
    state, mask = np.asarray(scenes.truth.state), np.asarray(scenes.truth.mask)
    assert (mask.sum(axis=2) == count[:, None]).all()
    time_s = np.asarray(scenes.truth.time_s[0])
    np.testing.assert_allclose(time_s, 0.5 * np.arange(20))
    straight = state[:, :1, :, :2] + time_s[:, None, None] * state[:, :1, :, 2:]
    np.testing.assert_allclose(state[..., :2], straight, atol=1e-9)
    speed = np.linalg.norm(state[..., 2:], axis=-1)
    assert ((speed >= 0.5) & (speed <= 6.0)).all()

    place, heading = np.asarray(scenes.pose.position_m), np.asarray(scenes.pose.heading_rad)
    for n in range(len(within)):
        seen = np.zeros((20, count[n]))
        for k, target in itertools.product(range(20), range(count[n])):
            now = state[n, k, target, :2], place[n, k], heading[n, k]
            seen[k, target] = frames.in_sight(*now, SECTOR, SCOPE_M)
        # Mid-window lies between two looks: half a second of the vehicle's arc is all but straight.
        middle, turned = place[n, 9:11].mean(axis=0), heading[n, 9:11].mean()
        polar = [
            frames.to_polar(state[n, 9:11, target, :2].mean(axis=0), middle, turned, (0.0, 0.0))
            for target in range(count[n])
        ]
        gaps = [
            max(np.rad2deg(abs(b - bb)) / 3.0, abs(r - rr) / 15.0)
            for (r, b), (rr, bb) in itertools.combinations(polar, 2)
        ]
        closest = min(gaps, default=9.0)
        assert min(r for r, _ in polar) > 9.99
        if abs(closest - 1) > 1e-3:
            assert within[n] == ((seen.sum(axis=0) >= 15).all() and closest > 1)


def test_the_vehicle_turns_evenly_and_looks_where_it_goes():
    pose = draw(jax.random.split(jax.random.key(1), 400), LIMITS, jnp.full(400, 5))[0].pose
    place, heading = np.asarray(pose.position_m), np.asarray(pose.heading_rad)
    turn = np.diff(heading, axis=1) / 0.5
    np.testing.assert_allclose(turn, turn[:, :1] + np.zeros_like(turn), atol=1e-12)
    assert np.abs(turn).max() <= 0.02
    assert np.abs(turn).max() > 0.018
    step = np.diff(place, axis=1) / 0.5
    speed = np.linalg.norm(step, axis=-1)
    np.testing.assert_allclose(speed, speed[:, :1] + np.zeros_like(speed), atol=1e-10)
    assert speed.max() <= 1.5
    way = np.arctan2(step[..., 1], step[..., 0])
    between = (heading[:, 1:] + heading[:, :-1]) / 2
    np.testing.assert_allclose(np.cos(way - between), 1.0, atol=1e-9)
    assert np.abs(place.mean(axis=1)).max() < 100.5


def test_random_targets_are_all_over_the_sector():
    scenes, _ = draw(jax.random.split(jax.random.key(2), 400), LIMITS, jnp.full(400, 5))
    middle = jax.tree.map(lambda x: np.asarray(x[:, 10]), (scenes.truth.state, scenes.pose))
    polar = np.array([
        frames.to_polar(state[:2], middle[1].position_m[n], middle[1].heading_rad[n], (0.0, 0.0))
        for n in range(400) for state in middle[0][n]
    ])  # fmt: skip
    assert (np.histogram(np.rad2deg(polar[:, 1]), bins=6, range=(-45, 45))[0] > 200).all()
    assert (np.histogram(polar[:, 0] ** 2, bins=6, range=(10**2, 150**2))[0] > 200).all()
    course = np.arctan2(middle[0][..., 3], middle[0][..., 2])
    assert np.histogram(course, bins=8, range=(-np.pi, np.pi))[0].min() > 150


def test_limits_that_no_target_keeps_lower_the_flag():
    limits = LIMITS._replace(seen_share=1.1)
    scenes, within = draw(jax.random.split(jax.random.key(0), 400), limits, jnp.full(400, 5))
    assert not within.any()
    assert np.isfinite(scenes.truth.state).all()
