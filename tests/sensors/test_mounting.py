"""Mounting calibration: exact without noise, against the loops, and how noise carries over."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from jaxtrack.sensors import Sightings, mounting_by_triangle, mounting_of_sightings
from jaxtrack.types import Pose
from tests.oracles import mounting as oracle

BETA, ARM = np.deg2rad(-2.7), (0.505, 0.0)
triangle = jax.jit(jax.vmap(mounting_by_triangle))
fit = jax.jit(jax.vmap(mounting_of_sightings, (0, None)))


def wrapped(angle):
    return np.arctan2(np.sin(angle), np.cos(angle))


def geometries(seed, trials, number=2, *, any_yaw=True, arm=ARM, beta=None, near=False):
    """Return β, and sightings of a fixed target from random places."""
    rng = np.random.default_rng(seed)
    beta = rng.uniform(-np.pi, np.pi, trials) if beta is None else np.full(trials, beta)
    place = rng.uniform(-15.0, 15.0, (trials, number, 2))
    target = rng.uniform(-15.0, 15.0, (trials, 1, 2))
    heading = rng.uniform(-np.pi, np.pi, (trials, number))
    if near:  # a target before the sonar, 5 m of way, all but equal yaws
        turn = rng.uniform(-np.pi, np.pi, (trials, 1))
        place = (
            5.0 * np.arange(number)[None, :, None] * np.stack([np.cos(turn), np.sin(turn)], axis=-1)
        )
        off, far = rng.uniform(-1.0, 1.0, (trials, 1)), rng.uniform(5.0, 20.0, (trials, 1))
        target = far[..., None] * np.stack([np.cos(off), np.sin(off)], axis=-1)
        heading = rng.uniform(-0.04, 0.04, (trials, number))
    if not any_yaw:
        heading = np.broadcast_to(heading[:, :1], heading.shape)
    cos, sin = np.cos(heading), np.sin(heading)
    stand = place + np.stack([cos * arm[0] - sin * arm[1], sin * arm[0] + cos * arm[1]], axis=-1)
    gap = target - stand
    bearing = np.arctan2(gap[..., 1], gap[..., 0]) - heading - beta[:, None]
    range_m = np.linalg.norm(gap, axis=-1)
    pose = Pose(jnp.asarray(place), jnp.asarray(heading))
    return beta, Sightings(jnp.asarray(range_m), jnp.asarray(wrapped(bearing)), pose), target[:, 0]


def one(sightings, n):
    return jax.tree.map(lambda x: np.asarray(x[n]), sightings)


def test_the_fit_is_exact_in_ten_thousand_random_geometries_at_any_yaw():
    for number in (2, 6):
        beta, sightings, target = geometries(0, 10_000, number)
        found = fit(sightings, ARM)
        assert found.valid.all()
        assert np.abs(wrapped(found.mount_rad - beta)).max() < 1e-9
        np.testing.assert_allclose(found.target_m, target, atol=1e-8)
        assert found.residual_m.max() < 1e-9


def test_the_triangle_is_exact_in_ten_thousand_random_geometries_at_equal_yaws():
    beta, sightings, _ = geometries(1, 10_000, any_yaw=False)
    # Where A lies all but on the way from B to C, the corner is an arccos near ±1, and half of the
    # digits are gone: rounding of 1e-15 in its cosine is 1e-8 and more of an angle.
    way = np.diff(np.asarray(sightings.pose.position_m), axis=1)[:, 0]
    a, (c, b) = np.linalg.norm(way, axis=-1), np.asarray(sightings.range_m).T
    flat = 1 - ((a**2 + c**2 - b**2) / (2 * a * c)) ** 2
    off = np.abs(wrapped(np.asarray(triangle(sightings)) - beta))
    assert (flat > 1e-8).mean() > 0.999
    assert (off * np.sqrt(flat))[flat > 1e-8].max() < 1e-12
    assert np.percentile(off, 99.9) < 1e-9


def test_without_its_sign_the_triangle_fails_on_one_side():
    beta, sightings, _ = geometries(2, 10_000, any_yaw=False)
    right = np.asarray(triangle(sightings))
    ranges, bearings = np.asarray(sightings.range_m), np.asarray(sightings.bearing_rad)
    side = np.sign(np.sin(bearings[:, 1] - bearings[:, 0]))
    way = np.diff(np.asarray(sightings.pose.position_m), axis=1)[:, 0]
    a, (c, b) = np.linalg.norm(way, axis=-1), ranges.T
    corner = np.arccos(np.clip((a**2 + c**2 - b**2) / (2 * a * c), -1.0, 1.0))
    fixed = right + np.where(side > 0, 0.0, 2 * corner)
    share = (np.abs(wrapped(fixed - beta)) > np.deg2rad(2.0)).mean()
    assert 0.42 < share < 0.52


def test_both_agree_with_the_loops_in_noise():
    rng = np.random.default_rng(3)
    _, sightings, _ = geometries(3, 40)
    noisy = sightings._replace(range_m=sightings.range_m + 0.05 * rng.normal(size=(40, 2)))
    got = np.asarray(triangle(noisy))
    for n in range(40):
        see = one(noisy, n)
        place, heading = see.pose.position_m.tolist(), see.pose.heading_rad.tolist()
        expected = oracle.triangle(see.range_m, see.bearing_rad, place, heading[0])
        np.testing.assert_allclose(wrapped(got[n] - expected), 0.0, atol=1e-7)
    for number in (2, 5):
        _, sightings, _ = geometries(4, 10, number)
        noise = 0.3 * rng.normal(size=(10, number))
        noisy = sightings._replace(range_m=sightings.range_m + noise)
        found = fit(noisy, ARM)
        for n in range(10):
            see = one(noisy, n)
            args = see.range_m, see.bearing_rad, see.pose.position_m, see.pose.heading_rad, ARM
            beta = oracle.least_squares(*args)
            np.testing.assert_allclose(wrapped(found.mount_rad[n] - beta), 0.0, atol=1e-6)
            square, mean = oracle.spread(beta, *args)
            np.testing.assert_allclose(found.residual_m[n], np.sqrt(square), rtol=1e-6)
            np.testing.assert_allclose(found.target_m[n], mean, atol=1e-5)


def noisy_errors(seed, number, sigma_m, trials=4000):
    """Return the median errors of triangle and fit, degrees, with noise on what the sonar sees."""
    rng = np.random.default_rng(seed)
    beta, sightings, _ = geometries(seed, trials, number, beta=BETA, near=True)
    unit = np.stack([np.cos(sightings.bearing_rad), np.sin(sightings.bearing_rad)], axis=-1)
    seen = np.asarray(sightings.range_m)[..., None] * unit
    seen = seen + sigma_m * rng.normal(size=seen.shape)
    noisy = sightings._replace(
        range_m=jnp.asarray(np.linalg.norm(seen, axis=-1)),
        bearing_rad=jnp.asarray(np.arctan2(seen[..., 1], seen[..., 0])),
    )
    median = lambda angle: np.median(np.abs(np.rad2deg(wrapped(np.asarray(angle) - beta))))
    two = jax.tree.map(lambda x: x[:, :2], noisy)
    return median(triangle(two)), median(fit(noisy, ARM).mount_rad)


def test_in_noise_the_closed_form_beats_the_triangle_and_many_sightings_beat_two():
    by_triangle, by_two = noisy_errors(5, 2, 0.05)
    _, by_many = noisy_errors(5, 8, 0.05)
    assert 0.50 < by_two < 0.60
    assert by_triangle > 1.5 * by_two
    assert by_many < 0.2 * by_two


def test_masked_sightings_may_hold_anything_and_none_of_use_are_said_to_be():
    beta, sightings, target = geometries(7, 20, 5)
    mask = jnp.array([True, True, False, True, True])
    broken = jax.tree.map(lambda x: jnp.asarray(x).at[:, 2].set(jnp.nan), sightings)
    masked = jax.jit(jax.vmap(mounting_of_sightings, (0, None, None)))
    found = masked(broken, ARM, mask)
    np.testing.assert_allclose(wrapped(found.mount_rad - beta), 0.0, atol=1e-9)
    np.testing.assert_allclose(found.target_m, target, atol=1e-8)
    kept = jax.tree.map(lambda x: x[:, np.flatnonzero(mask)[::-1]], sightings)
    np.testing.assert_allclose(fit(kept, ARM).mount_rad, found.mount_rad, atol=1e-12)

    for few in (jnp.arange(5) == 1, jnp.zeros(5, bool)):
        found = masked(sightings, ARM, few)
        assert not found.valid.any()
        assert (found.mount_rad == 0).all()
        assert np.isfinite(np.asarray(found.residual_m)).all()
    same = jax.tree.map(lambda x: jnp.broadcast_to(x[:, :1], x.shape), sightings)
    assert not fit(same, ARM).valid.any()


def test_jitted_gradients_are_those_of_differences_and_finite_where_all_is_degenerate():
    _, sightings, _ = geometries(8, 1, 3)
    sightings = jax.tree.map(lambda x: x[0], sightings)
    sightings = sightings._replace(range_m=sightings.range_m + jnp.array([0.1, -0.2, 0.1]))
    two = jax.tree.map(lambda x: x[:2], sightings)

    def by_fit(range_m):
        found = mounting_of_sightings(sightings._replace(range_m=range_m), ARM)
        return found.mount_rad + found.residual_m

    def by_triangle(range_m):
        return mounting_by_triangle(two._replace(range_m=range_m))

    for value, at in ((by_fit, sightings.range_m), (by_triangle, two.range_m)):
        slope = jax.jit(jax.grad(value))(at)
        for n in range(len(at)):
            step = jnp.zeros_like(at).at[n].set(1e-6)
            difference = (value(at + step) - value(at - step)) / 2e-6
            np.testing.assert_allclose(slope[n], difference, rtol=1e-6)
        assert np.isfinite(np.asarray(jax.jit(jax.grad(value))(jnp.zeros_like(at)))).all()
    flat = Sightings(jnp.array([5.0, 4.0]), jnp.zeros(2),
                     Pose(jnp.array([[0.0, 0.0], [1.0, 0.0]]), jnp.zeros(2)))  # fmt: skip
    slope = jax.jit(jax.grad(lambda r: mounting_by_triangle(flat._replace(range_m=r))))
    assert np.isfinite(np.asarray(slope(flat.range_m))).all()


def test_float32_one_trace_and_wrong_shapes():
    beta, sightings, _ = geometries(9, 50, 6)
    small = jax.tree.map(lambda x: jnp.asarray(x, jnp.float32), sightings)
    traces = []

    @jax.jit
    def run(sightings, arm):
        traces.append(1)
        return jax.vmap(mounting_of_sightings, (0, None))(sightings, arm)

    found = run(small, ARM)
    assert found.mount_rad.dtype == jnp.float32
    assert np.abs(wrapped(np.asarray(found.mount_rad) - beta)).max() < 1e-4
    run(small, (0.1, 0.2))
    assert len(traces) == 1
    with pytest.raises(ValueError, match=r"sightings.range_m: got shape \[6\], want \[2\]"):
        mounting_by_triangle(jax.tree.map(lambda x: x[0], sightings))
    with pytest.raises(TypeError, match="mask: got dtype float64, want booleans"):
        mounting_of_sightings(jax.tree.map(lambda x: x[0], sightings), ARM, jnp.ones(6))


def test_a_flat_triangle_with_the_target_behind_is_no_half_turn():
    pose = Pose(jnp.array([[0.0, 0.0], [-3.0, 0.0]]), jnp.zeros(2))
    beta = mounting_by_triangle(Sightings(jnp.array([5.0, 8.0]), jnp.zeros(2), pose))
    np.testing.assert_allclose(beta, 0.0, atol=1e-7)
