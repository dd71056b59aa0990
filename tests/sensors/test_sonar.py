"""The simulated sonar over 10⁵ looks: each statistic within four standard errors of the model."""

import functools

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy import stats

from jaxtrack.models import BeamSonar
from jaxtrack.sensors import in_sight, observe_beams, observe_known_beams, scan_of_beams
from jaxtrack.types import BeamScan, Pose, Truth
from tests.oracles import frames

LOOKS = 100_000
BEAMS = 90
STILL = (0.0, 0.0)


def scene(*polar, looks=LOOKS, heading_deg=0.0):
    """Return standing targets, (range, bearing in degrees) each, before a standing vehicle."""
    heading = np.deg2rad(heading_deg)
    place = [frames.to_earth(r, np.deg2rad(b), (5.0, -7.0), heading, STILL) for r, b in polar]
    state = np.array([(*xy, 0.0, 0.0) for xy in place]).reshape(-1, 4)
    truth = Truth(
        jnp.arange(float(looks)),
        jnp.asarray(np.broadcast_to(state, (looks, len(polar), 4))),
        jnp.ones((looks, len(polar)), bool),
    )
    pose = Pose(jnp.tile(jnp.array([5.0, -7.0]), (looks, 1)), jnp.full(looks, heading))
    return truth, pose


look_at = jax.jit(observe_beams, static_argnames=("beams", "false_alarms"))


def observed(seed, polar, sonar, heading_deg=0.0, **options):
    truth, pose = scene(*polar, heading_deg=heading_deg)
    scans = look_at(jax.random.key(seed), truth, pose, sonar, **options)
    return np.asarray(scans.range_m), np.asarray(scans.mask)


def assert_share(hits, expected):
    """The share of trials is as expected, within four standard errors of the expected one."""
    error = np.sqrt(expected * (1 - expected) / hits.size)
    assert abs(hits.mean() - expected) <= 4 * error, (hits.mean(), expected, error)


def assert_mean(samples, expected):
    error = np.std(samples, axis=0) / np.sqrt(len(samples))
    assert (np.abs(np.mean(samples, axis=0) - expected) <= 4 * error).all()


# Heading 40° and bearing 10.3°: beam floor(45 + 10.3) = 55.
def test_targets_are_detected_and_false_alarms_given_at_their_rates():
    sonar = BeamSonar(p_miss=0.7, p_false=0.2, sigma_m=3.0)
    range_m, mask = observed(0, [(80.0, 10.3)], sonar, heading_deg=40.0)
    assert_share(mask[:, 55], 0.3)
    others = np.delete(mask, 55, axis=1)
    assert_share(others, 0.2)
    # Every beam by itself, four standard errors widened for the largest of 89.
    error = np.sqrt(0.2 * 0.8 / LOOKS)
    assert np.abs(others.mean(axis=0) - 0.2).max() <= 5 * error
    # A detection says nothing about the beams beside it, nor about the next look.
    both = mask[:, 54] & mask[:, 55]
    assert_share(both, 0.3 * 0.2)
    assert_share(mask[1:, 55] & mask[:-1, 55], 0.3**2)
    assert_share(mask[:, 1:20] & mask[:, :19], 0.2**2)
    assert not range_m[~mask].any()


def test_range_noise_is_gaussian_with_the_given_sigma():
    range_m, mask = observed(1, [(80.0, 10.3)], BeamSonar(p_miss=0.1, p_false=0.0, sigma_m=3.0))
    error = range_m[:, 55][mask[:, 55]] - 80.0
    assert_mean(error, 0.0)
    assert_mean(error**2, 9.0)
    assert stats.kstest(error / 3.0, "norm").pvalue > 1e-4
    assert_mean(error[1:] * error[:-1], 0.0)


def test_false_ranges_are_uniform_over_the_scope():
    range_m, mask = observed(2, [], BeamSonar(p_false=0.02, range_max_m=120.0))
    false_m = range_m[mask]
    assert len(false_m) > 100_000
    assert (false_m > 0).all()
    assert (false_m <= 120.0).all()
    assert stats.kstest(false_m / 120.0, "uniform").pvalue > 1e-4


def test_at_most_one_false_alarm_a_scan_in_any_empty_beam():
    sonar = BeamSonar(p_miss=0.4, p_false=0.3)
    range_m, mask = observed(3, [(80.0, 10.3)], sonar, false_alarms="per_scan")
    assert_share(mask[:, 55], 0.6)
    others = np.delete(mask, 55, axis=1)
    count = others.sum(axis=1)
    assert count.max() == 1
    assert_share(count == 1, 0.3)
    assert_share(mask[:, 55] & (count == 1), 0.6 * 0.3)
    beam = np.argmax(others, axis=1)[count == 1]
    assert stats.chisquare(np.bincount(beam, minlength=89)).pvalue > 1e-4
    false_m = np.delete(range_m, 55, axis=1)[others]
    assert stats.kstest(false_m / 150.0, "uniform").pvalue > 1e-4


@pytest.mark.parametrize("share", [0.0, 0.5, 1.0])
def test_a_missed_beam_gives_clutter_as_often_as_asked_for(share):
    sonar = BeamSonar(p_miss=1.0, p_false=0.4, clutter_in_missed_beam=share)
    range_m, mask = observed(4, [(80.0, 10.3)], sonar)
    assert_share(mask[:, 55], 0.4 * share)
    assert_share(np.delete(mask, 55, axis=1), 0.4)
    if share == 1.0:
        false_m = range_m[:, 55][mask[:, 55]]
        assert stats.kstest(false_m / 150.0, "uniform").pvalue > 1e-4


def test_a_missed_beam_is_among_those_of_a_scan_s_one_false_alarm():
    sonar = BeamSonar(p_miss=1.0, p_false=0.9, clutter_in_missed_beam=0.5)
    target, beams = [(80.0, 10.3)], 4  # in beam 2
    _, mask = observed(5, target, sonar, beams=beams, false_alarms="per_scan")
    assert mask.sum(axis=1).max() == 1
    assert_share(mask.any(axis=1), 0.9)
    # Half of the time it is one of four beams that may give the alarm, else none of three.
    assert_share(mask[:, 2], 0.9 * 0.5 / 4)
    _, without = observed(
        5,
        target,
        sonar._replace(clutter_in_missed_beam=0.0),
        beams=beams,
        false_alarms="per_scan",
    )
    assert not without[:, 2].any()
    _, nowhere = observed(6, target, sonar, beams=1, false_alarms="per_scan")
    assert_share(nowhere[:, 0], 0.9 * 0.5)


@pytest.mark.slow
def test_of_two_targets_in_a_beam_the_nearer_echo_is_reported():
    sonar = BeamSonar(p_miss=0.3, p_false=0.9, sigma_m=1.0)
    targets = [(110.0, 10.6), (80.0, 10.3)]
    range_m, mask = observed(7, targets, sonar)
    near = np.abs(range_m[:, 55] - 80.0) < 10.0
    far = np.abs(range_m[:, 55] - 110.0) < 10.0
    assert_share(near, 0.7)
    assert_share(far, 0.3 * 0.7)
    assert_share(mask[:, 55], 1 - 0.3**2)
    assert (near | far | ~mask[:, 55]).all()
    # Two at one place: the smaller of two noisy ranges, mean −σ/√π.
    range_m, mask = observed(8, [(80.0, 10.3)] * 2, sonar._replace(p_miss=0.0))
    assert mask[:, 55].all()
    assert_mean(range_m[:, 55] - 80.0, -1.0 / np.sqrt(np.pi))


def test_noise_that_leaves_the_scope_loses_the_echo():
    sonar = BeamSonar(p_miss=0.2, p_false=0.3, sigma_m=3.0, clutter_in_missed_beam=1.0)
    targets = [(149.0, 10.3), (1.5, -20.5)]  # beams 55 and 24
    heard = 0.8 * np.array([stats.norm.cdf(1 / 3), stats.norm.cdf(0.5)])
    range_m, mask = observed(9, targets, sonar._replace(p_false=0.0))
    assert_share(mask[:, 55], heard[0])
    assert_share(mask[:, 24], heard[1])
    assert (range_m[mask] > 0).all()
    assert (range_m[mask] <= 150.0).all()
    # A lost echo's beam is a missed beam.
    _, mask = observed(10, targets, sonar)
    assert_share(mask[:, 55], heard[0] + (1 - heard[0]) * 0.3)


def test_sector_and_scope_end_where_they_say():
    sonar = BeamSonar(p_miss=0.0, p_false=0.0, sigma_m=0.0, mount_m=(2.0, -1.0))
    rng = np.random.default_rng(0)
    position = rng.uniform(-180.0, 180.0, (LOOKS, 1, 2))
    vehicle, heading = rng.uniform(-5.0, 5.0, (LOOKS, 2)), rng.uniform(-7.0, 7.0, LOOKS)
    state = np.concatenate([position, np.zeros_like(position)], axis=-1)
    truth = Truth(np.arange(float(LOOKS)), state, np.ones((LOOKS, 1), bool))
    pose = Pose(vehicle, heading)
    scans = look_at(jax.random.key(0), truth, pose, sonar)
    seen = np.asarray(in_sight(truth, pose, sonar).mask)[:, 0]
    mask, range_m = np.asarray(scans.mask), np.asarray(scans.range_m)
    for k in range(0, LOOKS, 20):
        place = position[k, 0], vehicle[k], heading[k]
        expected = frames.in_sight(*place, np.pi / 2, 150.0, (2.0, -1.0))
        assert seen[k] == expected == mask[k].any()
        if expected:
            distance, bearing = frames.to_polar(*place, (2.0, -1.0))
            beam = int(np.floor(np.rad2deg(bearing) + 45.0))
            assert mask[k].nonzero()[0].tolist() == [beam]
            np.testing.assert_allclose(range_m[k, beam], distance, rtol=1e-12)
    assert 0.1 < seen.mean() < 0.25


def test_what_is_masked_out_is_not_there_whatever_it_holds():
    truth, pose = scene((80.0, 10.3), (60.0, -5.5), looks=200)
    gone = truth._replace(
        state=truth.state.at[:100, 1].set(jnp.nan), mask=truth.mask.at[:100, 1].set(False)
    )
    far = truth._replace(state=truth.state.at[:100, 1, :2].set(1e4))
    sonar = BeamSonar(p_miss=0.2)
    without, beyond = (look_at(jax.random.key(1), t, pose, sonar) for t in (gone, far))
    for got, expected in zip(without[:4], beyond[:4], strict=True):
        np.testing.assert_array_equal(got, expected)
    assert np.isfinite(without.range_m).all()
    assert without.mask[100:, 39].mean() > 0.6
    assert without.valid.all()

    def total(state, sigma):
        scans = observe_beams(
            jax.random.key(1), gone._replace(state=state), pose, sonar._replace(sigma_m=sigma)
        )
        return jnp.where(scans.mask, scans.range_m, 0.0).sum()

    slopes = jax.jit(jax.grad(total, (0, 1)))(gone.state, jnp.array(3.0))
    assert all(np.isfinite(slope).all() for slope in slopes)
    assert not slopes[0][:100, 1].any()
    # A detected range grows as the target moves away: the gradient is the line of sight.
    detected = np.asarray(without.mask[:, 55])
    np.testing.assert_allclose(
        np.linalg.norm(np.asarray(slopes[0])[:, 0, :2], axis=-1), detected, atol=1e-12
    )


@pytest.mark.parametrize("false_alarms", ["per_beam", "per_scan"])
def test_keys_make_the_difference_and_no_target_is_a_scene(false_alarms):
    truth, pose = scene(looks=50)
    run = jax.jit(
        functools.partial(
            observe_beams, truth=truth, pose=pose, sonar=BeamSonar(), false_alarms=false_alarms
        )
    )
    first, again, other = (np.asarray(run(jax.random.key(n)).range_m) for n in (0, 0, 1))
    assert (first == again).all()
    assert (first != other).any()
    assert first.any()


def test_wrong_shapes_and_words_are_refused():
    truth, pose = scene((80.0, 0.0), looks=3)
    run = functools.partial(observe_beams, jax.random.key(0))
    with pytest.raises(ValueError, match=r"pose.heading_rad: got shape \[\], want \[3\]"):
        run(truth, Pose(pose.position_m, jnp.array(0.0)), BeamSonar())
    with pytest.raises(ValueError, match="false_alarms: got 'often', want one of per_beam"):
        run(truth, pose, BeamSonar(), false_alarms="often")
    with pytest.raises(ValueError, match="beams: got 0"):
        run(truth, pose, BeamSonar(), beams=0)


def test_positions_of_beams_and_their_covariances():
    truth, pose = scene((80.0, 10.3), (60.0, -30.2), looks=300, heading_deg=70.0)
    sonar = BeamSonar(p_miss=0.2, p_false=0.1, sigma_m=2.0, mount_m=(1.5, 0.2))
    scans = look_at(jax.random.key(3), truth, pose, sonar)
    weight = jnp.asarray(np.random.default_rng(0).uniform(size=scans.mask.shape))
    scans = scans._replace(weight=weight, range_m=jnp.where(scans.mask, scans.range_m, jnp.nan))
    positions = jax.jit(jax.vmap(scan_of_beams, (0, None)))(scans, sonar)
    np.testing.assert_array_equal(positions.mask, scans.mask)
    np.testing.assert_array_equal(positions.weight, weight)
    np.testing.assert_array_equal(positions.time_s, scans.time_s)
    assert positions.valid.all()
    assert positions.intensity is None
    assert all(np.isfinite(x).all() for x in jax.tree.leaves(positions))
    scans, positions = jax.tree.map(np.asarray, (scans, positions))
    for k, b in zip(*np.nonzero(scans.mask), strict=True):
        r, bearing, heading = scans.range_m[k, b], np.deg2rad(b - 44.5), np.deg2rad(70.0)
        expected = frames.to_earth(r, bearing, (5.0, -7.0), heading, (1.5, 0.2))
        np.testing.assert_allclose(positions.position_m[k, b], expected, atol=1e-10)
        u = np.array([np.cos(bearing + heading), np.sin(bearing + heading)])
        covariance = positions.covariance_m2[k, b]
        across = (np.array([-u[1], u[0]]), r**2 * np.deg2rad(1.0) ** 2 / 12)
        for axis, variance in ((u, 4.0), across):
            np.testing.assert_allclose(covariance @ axis, variance * axis, atol=1e-10)


def test_the_covariance_is_the_spread_of_a_target_s_true_position():
    # Wherever in beam 60 a target is, and whatever the noise, given the range that is reported.
    rng = np.random.default_rng(0)
    bearing = np.deg2rad(rng.uniform(15.0, 16.0, LOOKS))
    true_m = 100.0 + 2.0 * rng.normal(size=LOOKS)
    spread = np.stack([true_m * np.cos(bearing), true_m * np.sin(bearing)], axis=-1)
    scan = BeamScan(
        jnp.array(0.0),
        jnp.array(True),
        jnp.full(BEAMS, 100.0),
        jnp.ones(BEAMS, bool),
        Pose(jnp.zeros(2), jnp.array(0.0)),
    )
    position = scan_of_beams(scan, BeamSonar(sigma_m=2.0))
    np.testing.assert_allclose(spread.mean(axis=0), position.position_m[60], atol=0.02)
    np.testing.assert_allclose(np.cov(spread.T), position.covariance_m2[60], atol=0.05)


def test_origins_tell_echoes_from_false_alarms():
    # Targets 0 and 1 share beam 55, the nearer echo is reported; target 2 is out of sight.
    truth, pose = scene((80.0, 10.3), (60.0, 10.6), (60.0, 70.0), looks=4000)
    sonar = BeamSonar(p_miss=0.4, p_false=0.3, sigma_m=1.0, clutter_in_missed_beam=1.0)
    scans, origin = jax.jit(observe_known_beams)(jax.random.key(2), truth, pose, sonar)
    same = jax.jit(observe_beams)(jax.random.key(2), truth, pose, sonar)
    np.testing.assert_array_equal(same.range_m, scans.range_m)
    range_m, mask, origin = np.asarray(scans.range_m), np.asarray(scans.mask), np.asarray(origin)
    assert set(np.unique(np.delete(origin, 55, axis=1))) == {-1}
    for target, place_m, share in ((0, 80.0, 0.4 * 0.6), (1, 60.0, 0.6)):
        own = origin[:, 55] == target
        assert_share(own, share)
        assert mask[own, 55].all()
        assert (np.abs(range_m[own, 55] - place_m) < 6.0).all()
    assert_share(mask[origin[:, 55] < 0, 55], 0.3)
