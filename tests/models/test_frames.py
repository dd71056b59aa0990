"""Frames against the equations written out, there and back."""

import jax
import jax.numpy as jnp
import numpy as np

from jaxtrack.models import BeamSonar, beam_bearings, earth_to_polar, polar_to_earth
from jaxtrack.types import Pose
from tests.oracles import frames

there = jax.jit(jax.vmap(polar_to_earth))
back = jax.jit(jax.vmap(earth_to_polar))


def cases(size=500):
    rng = np.random.default_rng(0)
    pose = Pose(rng.uniform(-1e3, 1e3, (size, 2)), rng.uniform(-7.0, 7.0, size))
    mount = rng.uniform(-3.0, 3.0, (size, 2))
    return rng.uniform(0.5, 150.0, size), rng.uniform(-3.1, 3.1, size), pose, mount


def test_both_ways_follow_the_equations():
    range_m, bearing, pose, mount = cases()
    position = np.asarray(there(range_m, bearing, pose, mount))
    r, b = back(position, pose, mount)
    for k in range(len(range_m)):
        vehicle, heading = pose.position_m[k], pose.heading_rad[k]
        expected = frames.to_earth(range_m[k], bearing[k], vehicle, heading, mount[k])
        np.testing.assert_allclose(position[k], expected, rtol=0, atol=1e-11)
        polar = frames.to_polar(position[k], vehicle, heading, mount[k])
        np.testing.assert_allclose((r[k], b[k]), polar, rtol=0, atol=1e-11)


def test_there_and_back_is_where_it_began():
    range_m, bearing, pose, mount = cases()
    # Near the origin, where positions of a kilometre do not round the digits away.
    pose = pose._replace(position_m=pose.position_m / 1e2)
    r, b = back(there(range_m, bearing, pose, mount), pose, mount)
    np.testing.assert_allclose(r, range_m, rtol=1e-12, atol=0)
    np.testing.assert_allclose(b * range_m, bearing * range_m, rtol=0, atol=150.0 * 1e-12)
    position = np.random.default_rng(1).uniform(-100.0, 100.0, (500, 2))
    again = there(*back(position, pose, mount), pose, mount)
    np.testing.assert_allclose(again, position, rtol=0, atol=100.0 * 1e-12)


def test_headings_turn_clockwise_and_starboard_is_positive():
    mount = jnp.array([2.0, 0.5])
    east = Pose(jnp.array([10.0, 20.0]), jnp.array(np.pi / 2))
    ahead = polar_to_earth(jnp.array(5.0), jnp.array(0.0), east, mount)
    np.testing.assert_allclose(ahead, [10.0 - 0.5, 20.0 + 2.0 + 5.0], atol=1e-12)
    starboard = polar_to_earth(jnp.array(5.0), jnp.array(np.pi / 2), east, mount)
    np.testing.assert_allclose(starboard, [10.0 - 0.5 - 5.0, 20.0 + 2.0], atol=1e-12)


def test_the_sensor_itself_has_a_bearing_and_a_gradient():
    pose = Pose(jnp.zeros(2), jnp.array(0.3))

    def total(position):
        return sum(earth_to_polar(position, pose, (0.0, 0.0)))

    value, slope = jax.jit(jax.value_and_grad(total))(jnp.zeros(2))
    assert value == 0.0
    assert np.isfinite(slope).all()


def test_beams_divide_the_sector_evenly():
    bearings = np.rad2deg(beam_bearings(BeamSonar(), beams=90, dtype=jnp.float64))
    np.testing.assert_allclose(bearings, np.arange(90) - 44.5, atol=1e-12)
