"""The scanned sonar: power against a loop over facets, statistics within four standard errors."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from jaxtrack import sensors
from jaxtrack.sensors import Cylinders, Dike, PingSizes, ScanningSonar, observe_pings
from jaxtrack.types import Pose
from tests.oracles import pings as oracle

SONAR = ScanningSonar(range_max_m=20.0, mount_m=(0.5, -0.2), mount_rad=-0.05)
STEADY = SONAR._replace(fluctuation_db=0.0)
SIZES = PingSizes(bins=80)
look = jax.jit(observe_pings, static_argnames="sizes")


def course(pings, seed=0, dtype=np.float64):
    """Return times, bearings and poses of a vehicle that moves and turns in every ping."""
    rng = np.random.default_rng(seed)
    bearing = np.linspace(-1.0, 1.0, pings)
    place = rng.uniform(-2.0, 2.0, 2) + 0.1 * np.cumsum(rng.normal(size=(pings, 2)), axis=0)
    heading = 0.4 + 0.02 * rng.normal(size=pings)
    cast = lambda x: jnp.asarray(x, dtype)
    return cast(0.06 * np.arange(pings)), cast(bearing), Pose(cast(place), cast(heading))


def things(pings, *rows, seed=1, dtype=np.float64):
    """Return cylinders, (x, y, radius, level, depth) each, that move from ping to ping."""
    rng = np.random.default_rng(seed)
    table = np.array(rows, np.float64).reshape(-1, 5)
    moves = 0.05 * np.cumsum(rng.normal(size=(pings, len(table), 2)), axis=0)
    cast = lambda x: jnp.asarray(x, dtype)
    place = cast(table[None, :, :2] + moves - moves[:1])
    return Cylinders(place, jnp.ones(place.shape[:2], bool), *(cast(x) for x in table[:, 2:].T))


def still(pings, *rows):
    found = things(1, *rows)
    position = jnp.broadcast_to(found.position_m, (pings, *found.position_m.shape[1:]))
    return found._replace(position_m=position, mask=jnp.ones(position.shape[:2], bool))


def ahead(pings):
    return jnp.zeros(pings), jnp.zeros(pings), Pose(jnp.zeros((pings, 2)), jnp.zeros(pings))


def assert_mean(samples, expected):
    error = np.std(samples, axis=0) / np.sqrt(len(samples))
    assert (np.abs(np.mean(samples, axis=0) - expected) <= 4 * error).all()


# At 140 dB the reverberation, of power 1, is a rounding error of what the objects send back.
LOUD = 140.0
THINGS = (
    (9.0, 3.0, 0.4, LOUD, 0.5), (12.0, -4.0, 0.0, LOUD, 0.0), (5.0, 1.0, 1.5, LOUD, -1.0),
    (-8.0, 2.0, 0.4, LOUD, 0.0), (40.0, 2.0, 0.4, LOUD, 0.0),
)  # fmt: skip


def test_cylinders_echo_as_a_loop_over_their_facets_has_it():
    pings = 61
    time_s, bearing, pose = course(pings)
    cylinders = things(pings, *THINGS)
    seen = look(jax.random.key(0), time_s, bearing, pose, cylinders, STEADY, sizes=SIZES)
    got = np.asarray(seen.intensity) ** 2
    widths = STEADY.beam_rad, STEADY.beam_up_rad
    for q in range(pings):
        where = np.asarray(pose.position_m[q]), float(pose.heading_rad[q]), STEADY.mount_m
        here = np.asarray(cylinders.position_m[q])
        every = [(here[k], *THINGS[k][2:]) for k in range(len(THINGS))]
        axis = float(bearing[q]) + STEADY.mount_rad
        power = np.array(oracle.ping(80, 20.0, axis, *where, widths, every, SIZES.facets))
        heard = power > 1e9
        np.testing.assert_allclose(got[q][heard], power[heard], rtol=2e-3)
        assert (got[q][~heard] < 2e9).all()
    assert (got > 1e9).sum() > 50
    np.testing.assert_array_equal(seen.pose.position_m, pose.position_m)
    np.testing.assert_array_equal(seen.time_s, time_s)
    assert seen.mask.all()


def test_a_dike_echoes_where_the_rays_strike_it():
    pings = 61
    time_s, bearing, pose = course(pings, seed=3)
    none, dike = things(pings), Dike(11.0, 0.7, LOUD, 0.0)
    seen = look(jax.random.key(0), time_s, bearing, pose, none, STEADY, dike=dike, sizes=SIZES)
    got = np.asarray(seen.intensity) ** 2
    for q in range(pings):
        where = np.asarray(pose.position_m[q]), float(pose.heading_rad[q]), STEADY.mount_m
        axis = float(bearing[q]) + STEADY.mount_rad
        wall = STEADY.beam_rad, 11.0, 0.7, LOUD, SIZES.rays
        power = np.array(oracle.dike_ping(80, 20.0, axis, *where, *wall))
        heard = power > 1e9
        np.testing.assert_allclose(got[q][heard], power[heard], rtol=2e-3)
        assert (got[q][~heard] < 2e9).all()
    assert (got > 1e9).any(axis=1).mean() > 0.6
    behind = Dike(11.0, 0.7 + np.pi, LOUD, 0.0)
    seen = look(jax.random.key(0), time_s, bearing, pose, none, STEADY, dike=behind, sizes=SIZES)
    assert (np.asarray(seen.intensity) < 20).all()


def test_a_slope_echoes_from_its_foot_up():
    dike = Dike(10.0, 0.0, 60.0, 2.0)
    sonar = STEADY._replace(mount_m=(0.0, 0.0), mount_rad=0.0)
    seen = look(jax.random.key(0), *ahead(4000), things(4000), sonar, dike=dike, sizes=SIZES)
    bins = np.asarray(seen.intensity).T > 100.0  # of 0.25 m
    assert not bins[:39].any()
    assert not bins[49:].any()
    share = bins[41:47].mean(axis=1)
    assert np.ptp(share) < 4 * np.sqrt(2 * 0.25 / 4000)


def test_open_water_is_k_distributed_reverberation_and_echoes_add_their_power():
    # Range 10 m: the middle of bins 39 and 40, each with half of the power.
    sonar = STEADY._replace(mount_m=(0.0, 0.0), mount_rad=0.0)
    point = still(20_000, (10.0, 0.0, 0.0, 16.0, 0.0))
    seen = look(jax.random.key(0), *ahead(20_000), point, sonar, sizes=SIZES)
    power = np.asarray(seen.intensity) ** 2
    for r in (39, 40):
        assert_mean(power[:, r], 1 + 10**1.6 / 2)
    for r in (0, 38, 41, 79):
        assert_mean(power[:, r], 1.0)
        assert_mean(power[:, r] ** 2, 2 * (1 + 1 / SIZES.shape))
    # Cells are independent: the mean of products is the product of the means.
    assert_mean(power[:, 10] * power[:, 11], 1.0)
    assert_mean(power[1:, 10] * power[:-1, 10], 1.0)


def test_levels_fluctuate_by_three_decibels_ping_by_ping_and_object_by_object():
    sonar = SONAR._replace(mount_m=(0.0, 0.0), mount_rad=0.0)
    points = still(20_000, (10.125, 0.0, 0.0, 120.0, 0.0), (15.125, 0.0, 0.3, 120.0, 0.0))
    seen = look(jax.random.key(5), *ahead(20_000), points, sonar, sizes=SIZES)
    level = 20 * np.log10(np.asarray(seen.intensity))
    one, other = level[:, 40], level[:, 59]
    assert_mean(one, 120.0 + 10 * np.log10(10 / 10.125))
    for x in (one, other):
        np.testing.assert_allclose(x.std(), 3.0, atol=4 * 3.0 / np.sqrt(2 * 20_000))
    assert_mean((one - one.mean()) * (other - other.mean()), 0.0)
    assert_mean((one[1:] - one.mean()) * (one[:-1] - one.mean()), 0.0)


def test_a_beam_has_a_quarter_of_its_two_way_power_at_half_its_width():
    width = np.deg2rad(20.0)
    half = np.array([0.0, width / 2, -width / 2])
    expected = [1.0, 0.25, 0.25]
    np.testing.assert_allclose(sensors.beam_pattern(jnp.asarray(half), width), expected, rtol=1e-5)
    angle = np.linspace(-3.1, 3.1, 63)
    got = np.asarray(sensors.beam_pattern(jnp.asarray(angle), width))
    np.testing.assert_allclose(got, [oracle.pattern(a, width) for a in angle], rtol=0, atol=2e-6)
    assert (got[np.abs(angle) > np.pi / 2] == 0).all()


def test_sweeps_go_to_and_fro_a_step_a_ping():
    for preset, sector, ping_s in (
        (sensors.IMAGENEX_881L, 120.0, 0.06),
        (sensors.SUPER_SEAKING_LOW, 118.8, 0.075),
        (sensors.SUPER_SEAKING_HIGH, 119.7, 0.15),
    ):
        pings = preset.sizes.pings
        time_s, bearing = sensors.sweeps(preset.sonar, frames=4, pings=pings)
        np.testing.assert_allclose(time_s.ravel(), ping_s * np.arange(4 * pings), atol=1e-9)
        port_to_starboard = np.linspace(-sector / 2, sector / 2, pings)
        for t in range(4):
            expected = port_to_starboard if t % 2 == 0 else port_to_starboard[::-1]
            np.testing.assert_allclose(np.rad2deg(bearing[t]), expected, atol=1e-9)
    assert sensors.IMAGENEX_881L.sizes == PingSizes(101, 500, 16, 8, 3)
    assert sensors.IMAGENEX_881L.sonar.range_max_m == 40.0


def test_navigation_is_off_by_a_share_of_the_distance_run():
    rng = np.random.default_rng(0)
    place = np.cumsum(rng.normal(size=(300, 2)), axis=0)
    pose = Pose(jnp.asarray(place), jnp.asarray(rng.normal(size=300)))
    drift = jax.jit(jax.vmap(sensors.drifting_pose, (0, None, None)))
    reported = drift(jax.random.split(jax.random.key(0), 500), pose, 0.007)
    off = np.asarray(reported.position_m) - place
    run, expected = 0.0, [0.0]
    for k in range(1, 300):
        run += np.hypot(*(place[k] - place[k - 1]))
        expected.append(0.007 * run)
    np.testing.assert_allclose(np.linalg.norm(off, axis=-1), np.tile(expected, (500, 1)), atol=1e-9)
    assert_mean(off[:, -1], 0.0)
    np.testing.assert_array_equal(reported.heading_rad[0], pose.heading_rad)
    exact = sensors.drifting_pose(jax.random.key(0), pose, 0.0)
    np.testing.assert_array_equal(exact.position_m, pose.position_m)


def test_what_is_masked_or_out_of_reach_changes_nothing():
    time_s, bearing, pose = course(31)
    args = jax.random.key(2), time_s, bearing, pose
    empty = look(*args, things(31), STEADY, sizes=SIZES)
    gone = things(31, (9.0, 3.0, 0.4, LOUD, 0.5))
    gone = gone._replace(
        position_m=jnp.full_like(gone.position_m, jnp.nan), mask=jnp.zeros_like(gone.mask)
    )
    far = things(31, (90.0, 3.0, 0.4, 60.0, 0.5))
    for cylinders in (gone, far):
        seen = look(*args, cylinders, STEADY, sizes=SIZES)
        np.testing.assert_array_equal(seen.intensity, empty.intensity)
    # An object in the place of the sonar is heard in the first bins, and nothing is NaN.
    at = gone._replace(position_m=jnp.zeros_like(gone.position_m), mask=jnp.ones_like(gone.mask))
    here = Pose(jnp.zeros((31, 2)), jnp.zeros(31))
    sonar = STEADY._replace(mount_m=(0.0, 0.0))
    seen = look(jax.random.key(2), time_s, bearing, here, at, sonar, sizes=SIZES)
    assert np.isfinite(np.asarray(seen.intensity)).all()


def test_seeds_vmap_float32_and_one_trace():
    time_s, bearing, pose = course(31)
    cylinders, dike = things(31, *THINGS[:3]), Dike(15.0, 0.5)
    traces = []

    @jax.jit
    def run(key, level_db):
        traces.append(1)
        now = cylinders._replace(level_db=cylinders.level_db - LOUD + level_db)
        seen = observe_pings(key, time_s, bearing, pose, now, SONAR, dike=dike, sizes=SIZES)
        return seen.intensity

    keys = jax.random.split(jax.random.key(0), 3)
    one = [np.asarray(run(key, 30.0)) for key in keys]
    np.testing.assert_array_equal(one[0], run(keys[0], 30.0))
    assert not np.allclose(one[0], one[1])
    assert not np.allclose(one[0], run(keys[0], 40.0))
    assert len(traces) == 1
    together = jax.jit(jax.vmap(run, (0, None)))(keys, 30.0)
    np.testing.assert_allclose(together, one, rtol=1e-12)

    small = (*course(31, dtype=np.float32), things(31, *THINGS[:3], dtype=np.float32))
    got = look(keys[0], *small, STEADY, sizes=SIZES).intensity
    assert got.dtype == jnp.float32
    wide = look(keys[0], time_s, bearing, pose, cylinders, STEADY, sizes=SIZES).intensity
    heard = np.asarray(wide) > 1e5
    np.testing.assert_allclose(np.asarray(got)[heard], np.asarray(wide)[heard], rtol=2e-3)


def test_wrong_arguments_are_named():
    time_s, bearing, pose = course(5)
    good = things(5, *THINGS[:2])
    run = lambda bearing=bearing, cylinders=good, sonar=SONAR, sizes=SIZES: observe_pings(
        jax.random.key(0), time_s, bearing, pose, cylinders, sonar, sizes=sizes
    )
    with pytest.raises(ValueError, match=r"bearing_rad: got shape \[4\], want \[5\]"):
        run(bearing=bearing[:4])
    with pytest.raises(ValueError, match=r"cylinders.radius_m: got shape \[1\], want \[2\]"):
        run(cylinders=good._replace(radius_m=jnp.ones(1)))
    with pytest.raises(TypeError, match=r"cylinders.mask: got dtype float64, want booleans"):
        run(cylinders=good._replace(mask=jnp.ones((5, 2))))
    with pytest.raises(ValueError, match=r"sonar.beam_rad: got 0.0, want a positive"):
        run(sonar=SONAR._replace(beam_rad=0.0))
    with pytest.raises(ValueError, match=r"sizes.bins: got 0, want an int ≥ 1"):
        run(sizes=SIZES._replace(bins=0))
