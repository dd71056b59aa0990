"""The thresholded cloud against a loop over cells; masks, padding and what does not fit."""

import functools

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from jaxtrack.sensors import ScanningSonar, cloud_of_pings
from jaxtrack.types import Pings, Pose
from tests.oracles import pings as oracle

SONAR = ScanningSonar(range_max_m=20.0, mount_m=(0.5, -0.2), mount_rad=-0.05)
GAMMA = 2.5
PINGS, BINS = 21, 40


@functools.partial(jax.jit, static_argnames="points")
def cloud(pings, threshold=GAMMA, points=160):
    return cloud_of_pings(pings, SONAR, threshold, points=points)


def sweep(seed=0, pings=PINGS):
    rng = np.random.default_rng(seed)
    pose = Pose(jnp.asarray(rng.uniform(-9, 9, (pings, 2))), jnp.asarray(rng.uniform(-3, 3, pings)))
    return Pings(
        jnp.asarray(100.0 + np.arange(pings)),
        jnp.asarray(rng.uniform(-1.0, 1.0, pings)),
        jnp.asarray(np.abs(rng.normal(size=(pings, BINS))) * 1.5),
        jnp.ones(pings, bool),
        pose,
    )


def rows(pings):
    """Return the sweep as the oracle wants it."""
    return [
        (float(pings.time_s[q]), float(pings.bearing_rad[q]), np.asarray(pings.pose.position_m[q]),
         float(pings.pose.heading_rad[q]), np.asarray(pings.intensity[q]))
        if pings.mask[q] else None
        for q in range(len(pings.mask))
    ]  # fmt: skip


def assert_same(got, expected, time_s=100.0):
    """The cloud holds the oracle's points, in whatever order."""
    scan, overflow = got
    points, crowded = expected
    assert (bool(overflow), int(scan.mask.sum())) == (crowded, len(points))
    live = np.asarray(scan.mask)
    columns = (
        scan.position_m,
        scan.intensity[:, None],
        scan.weight[:, None],
        scan.delay_s[:, None],
    )
    table = np.concatenate([np.asarray(x)[live] for x in columns], axis=1)
    wanted = np.array([(*at, a, w, t - time_s) for at, a, w, t in points]).reshape(-1, 5)
    by_intensity = lambda x: x[np.argsort(x[:, 2])]
    np.testing.assert_allclose(by_intensity(table), by_intensity(wanted), rtol=0, atol=1e-9)
    for field in (scan.position_m, scan.intensity, scan.weight, scan.delay_s):
        assert not np.asarray(field)[~live].any()


def of_oracle(pings, threshold=GAMMA, points=160):
    args = SONAR.range_max_m, SONAR.mount_m, SONAR.mount_rad, points
    return oracle.cloud(rows(pings), threshold, *args)


def test_loud_cells_become_points_where_their_pings_pose_puts_them():
    pings = sweep()
    got = cloud(pings)
    assert_same(got, of_oracle(pings))
    assert 50 < got[0].mask.sum() < 160
    assert (float(got[0].time_s), bool(got[0].valid)) == (100.0, True)
    for threshold in (1.5, 3.0, 5.0):
        assert_same(cloud(pings, threshold), of_oracle(pings, threshold))


def test_what_does_not_fit_is_said_and_the_nearest_are_kept():
    pings = sweep()
    got = cloud(pings, points=40)
    assert got[1]
    # Cells of one range are alike near: which of the last range are kept is not promised.
    every, _ = of_oracle(pings)
    ranges = lambda scan, live: np.sort(
        np.abs(np.asarray(scan.intensity)[live][:, None] - [a for _, a, *_ in every]).argmin(axis=1)
    )
    kept = ranges(got[0], np.asarray(got[0].mask))
    cell = np.sort(np.nonzero(np.asarray(pings.intensity).T.ravel() >= GAMMA)[0])[:40] // PINGS
    by_range = np.array([r for r in range(BINS) for a in np.asarray(pings.intensity)[:, r]
                         if a >= GAMMA])  # fmt: skip
    np.testing.assert_array_equal(by_range[kept], cell)


def test_masked_pings_may_hold_anything_and_empty_sweeps_are_told_from_none():
    pings = sweep()
    mask = jnp.arange(PINGS) % 3 != 0
    broken = jax.tree.map(
        lambda x: jnp.where(mask.reshape(-1, *[1] * (x.ndim - 1)), x, jnp.nan),
        pings._replace(mask=jnp.zeros(PINGS)),
    )._replace(mask=mask)
    got = cloud(broken)
    assert_same(got, of_oracle(pings._replace(mask=mask)), 101.0)
    for leaf in jax.tree.leaves(got):
        assert np.isfinite(np.asarray(leaf)).all()
    silent = pings._replace(intensity=0 * pings.intensity)
    scan, overflow = cloud(silent)
    assert (int(scan.mask.sum()), bool(scan.valid), bool(overflow)) == (0, True, False)
    none = pings._replace(mask=jnp.zeros(PINGS, bool))
    scan, overflow = cloud(none)
    assert (int(scan.mask.sum()), bool(scan.valid), bool(overflow)) == (0, False, False)
    dead = pings._replace(intensity=pings.intensity.at[3].set(jnp.nan))
    lost = pings._replace(intensity=pings.intensity.at[3].set(0.0))
    for x, y in zip(jax.tree.leaves(cloud(dead)), jax.tree.leaves(cloud(lost)), strict=True):
        np.testing.assert_array_equal(x, y)


def test_permuting_and_padding_change_nothing():
    pings = sweep()
    order = np.random.default_rng(1).permutation(PINGS)
    assert_same(cloud(jax.tree.map(lambda x: x[order], pings)), of_oracle(pings))
    padded = jax.tree.map(lambda x: jnp.concatenate([x, 0 * x[:4] + 7 * x[:4]]), pings._replace(
        mask=jnp.zeros(PINGS)))._replace(mask=jnp.arange(PINGS + 4) < PINGS)  # fmt: skip
    assert_same(cloud(padded), of_oracle(pings))
    assert_same(cloud(pings, points=300), of_oracle(pings))


def test_vmap_float32_gradients_and_one_trace():
    together = jax.tree.map(lambda *x: jnp.stack(x), *(sweep(seed) for seed in range(3)))
    traces = []

    @jax.jit
    def run(pings, threshold):
        traces.append(1)
        return jax.vmap(cloud_of_pings, (0, None, None))(pings, SONAR, threshold)

    many = run(together, GAMMA)
    run(together, 3.0)
    assert len(traces) == 1
    for seed in range(3):
        assert_same(jax.tree.map(lambda x: x[seed], many), of_oracle(sweep(seed)))  # noqa: B023
    small = jax.tree.map(lambda x: x.astype(jnp.float32) if x.dtype == float else x, together)
    got, _ = run(small, GAMMA)
    assert got.position_m.dtype == got.weight.dtype == jnp.float32
    np.testing.assert_allclose(got.position_m, many[0].position_m, atol=1e-4)

    pings = sweep()

    def total(intensity, position_m):
        pose = pings.pose._replace(position_m=position_m)
        scan, _ = cloud_of_pings(pings._replace(intensity=intensity, pose=pose), SONAR, GAMMA)
        return (scan.weight[:, None] * jnp.sin(scan.position_m)).sum()

    value, slopes = jax.jit(total), jax.jit(jax.grad(total, (0, 1)))
    at = pings.intensity, pings.pose.position_m
    slope = slopes(*at)
    loud = np.unravel_index(np.asarray(at[0]).argmax(), at[0].shape)
    for n, place in ((0, loud), (1, (loud[0], 0))):
        step = [jnp.zeros_like(x) for x in at]
        step[n] = step[n].at[place].set(1e-6)
        more, less = ([x + s * d for x, d in zip(at, step, strict=True)] for s in (1, -1))
        np.testing.assert_allclose(slope[n][place], (value(*more) - value(*less)) / 2e-6, rtol=1e-6)
    for leaf in jax.tree.leaves((slope, slopes(0 * at[0], at[1]))):
        assert np.isfinite(np.asarray(leaf)).all()


def test_wrong_arguments_are_named():
    pings = sweep()
    with pytest.raises(ValueError, match=r"threshold: got 0.0, want a positive"):
        cloud_of_pings(pings, SONAR, 0.0)
    with pytest.raises(ValueError, match=r"pings.intensity: got shape \[40\], want \[Q, R\]"):
        cloud_of_pings(jax.tree.map(lambda x: x[0], pings), SONAR)
    with pytest.raises(TypeError, match=r"pings.mask: got dtype float64, want booleans"):
        cloud_of_pings(pings._replace(mask=jnp.ones(PINGS)), SONAR)
    with pytest.raises(ValueError, match="points: got 0"):
        cloud_of_pings(pings, SONAR, points=0)
