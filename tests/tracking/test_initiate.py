"""From lines to tracks: whose detections they are, where the targets are and how they move."""

import functools
import math

import chex
import jax
import jax.numpy as jnp
import numpy as np
import pytest

from jaxtrack.hough.pairs import SpeedGate
from jaxtrack.tracking import InitiateParams, initiate
from jaxtrack.types import Lines, Scan, Stage
from tests.hough.cases import with_nan_behind_masks
from tests.metrics.differences import assert_gradients_agree
from tests.oracles import lines as oracle
from tests.oracles import rls

LOOKS, SIZE = 6, 7
SIGMA_M = 10.0
PARAMS = InitiateParams(sigma_m=SIGMA_M, speed=SpeedGate(80.0, 400.0))
start = jax.jit(functools.partial(initiate, nearest=4))


def random_scene(seed):
    """Return looks at two targets (detections 0 and 1 of every look), their lines and end states.

    Clutter is uniform, but for two detections a look right on the first target's line.
    """
    rng = np.random.default_rng(seed)
    time_s = np.cumsum(rng.uniform(1.8, 2.2, LOOKS))
    delay_s = rng.uniform(-0.2, 0.2, (LOOKS, SIZE))
    position = rng.uniform((0.0, 0.0), (3500.0, 1600.0), (LOOKS, SIZE, 2))
    heading = rng.uniform(0.0, 2 * math.pi)
    found, ends = [], []
    for target in range(2):
        along = np.array([math.cos(heading + target), math.sin(heading + target)])
        middle = rng.normal((1700.0, 800.0), 150.0)
        speed = rng.uniform(150.0, 300.0)
        elapsed = time_s + delay_s[:, target] - time_s.mean()
        position[:, target] = middle + elapsed[:, None] * speed * along
        position[:, target] += SIGMA_M * rng.normal(size=(LOOKS, 2))
        if target == 0:
            anywhere = rng.uniform(-1500.0, 1500.0, (LOOKS, 2, 1))
            position[:, 2:4] = middle + anywhere * along + 20.0 * rng.normal(size=(LOOKS, 2, 2))
        found.append(oracle.line_through(middle, middle + along, (0.0, 0.0)))
        end = middle + (time_s[-1] - time_s.mean()) * speed * along
        ends.append(np.concatenate([end, speed * along]))
    scan = Scan(
        time_s=time_s,
        valid=np.ones(LOOKS, bool),
        position_m=position,
        mask=np.ones((LOOKS, SIZE), bool),
        delay_s=delay_s,
    )  # pyright: ignore[reportArgumentType]
    return scan, table_of(found), np.array(ends)


def table_of(found, slots=3):
    """Return a table of lines; NaN behind the mask."""
    rho, theta = (
        np.array([line[axis] for line in found] + [np.nan] * (slots - len(found)))
        for axis in (0, 1)
    )
    mask = np.arange(slots) < len(found)
    votes = np.where(mask, 9.0 - np.arange(slots), np.nan)
    return Lines(rho, theta, votes, mask)  # pyright: ignore[reportArgumentType]


def fit(scan, members, forgetting=1.0, delta=1e4):
    """Return the oracle's state at the last look of the members' regression, and its covariance.

    It starts at the first member, in units of the window's length: there δ is wide.
    """
    looks = np.flatnonzero(members >= 0)
    index = members[looks]
    span = float(scan.time_s[-1] - scan.time_s[0])
    time = (scan.time_s[looks] + scan.delay_s[looks, index]) / span
    z, everything = scan.position_m[looks, index], np.ones(len(looks), bool)
    end = float(scan.time_s[-1]) / span
    coefficients, inverse = rls.batch(time, z - z[0], everything, end, forgetting, delta)
    state = np.concatenate([z[0] + coefficients[0], coefficients[1] / span])
    units = np.diag([1.0, 1.0 / span])
    return state, SIGMA_M**2 * np.kron(units @ inverse @ units, np.eye(2))


@pytest.mark.parametrize("forgetting", [1.0, 0.9])
def test_targets_in_clutter(forgetting):
    right = 0
    for seed in range(12):
        scan, table, ends = random_scene(seed)
        tracks, info = start(scan, table, PARAMS._replace(forgetting=forgetting))
        np.testing.assert_array_equal(tracks.mask, [True, True, False])
        np.testing.assert_array_equal(tracks.identity, [0, 1, -1])
        np.testing.assert_array_equal(tracks.stage, [Stage.TENTATIVE] * 2 + [Stage.EMPTY])
        np.testing.assert_array_equal(tracks.log_score, [9.0, 8.0, 0.0])
        np.testing.assert_array_equal(tracks.existence, [1.0, 1.0, 0.0])
        assert tracks.time_s == scan.time_s[-1]
        for target in range(2):
            members = np.asarray(info.member[target])
            right += int((members == target).sum())
            expected, covariance = fit(scan, members, forgetting)
            np.testing.assert_allclose(tracks.mean[target], expected, rtol=1e-8)
            np.testing.assert_allclose(tracks.covariance[target], covariance, rtol=1e-8, atol=1e-9)
            # What the start pulls is small beside the noise.
            free, _ = fit(scan, members, forgetting, delta=1e12)
            sd = np.sqrt(np.diag(covariance))
            assert (np.abs(tracks.mean[target] - free) < 0.1 * sd).all()
            if (members == target).all():
                assert (np.abs(tracks.mean[target] - ends[target]) < 5.0 * sd).all()
    assert right >= 0.97 * 12 * 2 * LOOKS  # a clutter point may lie nearer than the target's


def test_smoothed_positions_are_the_regressions_so_far():
    scan, table, _ = random_scene(1)
    _, info = start(scan, table, PARAMS)
    assert np.isfinite(info.smoothed_m).all()
    assert info.smoothed_m.shape == (3, LOOKS, 2)
    np.testing.assert_array_equal(info.smoothed_m[2], 0.0)
    members = np.asarray(info.member[0])
    for looks in range(2, LOOKS + 1):
        here = np.where(np.arange(LOOKS) < looks, members, -1)
        state, _ = fit(scan, here)
        last = looks - 1
        ago = scan.time_s[last] + scan.delay_s[last, members[last]] - scan.time_s[-1]
        expected = state[:2] + ago * state[2:]
        np.testing.assert_allclose(info.smoothed_m[0, last], expected, rtol=1e-8)


def test_a_missed_detection_and_a_lost_look_have_no_member():
    scan, table, _ = random_scene(2)
    scan.mask[1, 0] = False
    scan.mask[4, 2:] = False
    scan.valid[3] = False
    whole, _, _ = random_scene(2)
    hidden = with_nan_behind_masks(scan)
    hidden = hidden._replace(time_s=np.where(scan.valid, scan.time_s, np.nan))
    expected, info = start(scan, table, PARAMS)
    got, same = start(hidden, table, PARAMS)
    chex.assert_trees_all_equal(got, expected)
    chex.assert_trees_all_equal(same, info)
    assert info.member[0, 3] == info.member[1, 3] == -1
    assert info.member[0, 1] != 0
    assert info.member[0, 4] == 0
    expected, _ = fit(whole, np.asarray(info.member[0]))
    np.testing.assert_allclose(got.mean[0], expected, rtol=1e-8)


def test_lines_that_are_masked_or_that_nothing_moves_along_give_empty_slots():
    scan, table, _ = random_scene(3)
    scan.position_m[:, 2:] = 1e5  # far from any line; targets stay
    away = (float(table.rho_m[0]) + 700.0, float(table.theta_rad[0]))
    rows = [away, (float(table.rho_m[1]), float(table.theta_rad[1]))]
    tracks, info = start(scan, table_of(rows), PARAMS)
    np.testing.assert_array_equal(tracks.mask, [False, True, False])
    np.testing.assert_array_equal(tracks.identity, [-1, 1, -1])
    np.testing.assert_array_equal(tracks.stage, [Stage.EMPTY, Stage.TENTATIVE, Stage.EMPTY])
    np.testing.assert_array_equal(info.member[0], -1)
    np.testing.assert_array_equal(info.member[2], -1)
    for table in (tracks.mean, tracks.covariance, tracks.log_score, info.smoothed_m):
        assert np.isfinite(table).all()
        np.testing.assert_array_equal(table[np.array([0, 2])], 0.0)


def test_too_few_looks_and_wrong_speeds_make_no_track():
    scan, table, _ = random_scene(4)
    scan.mask[:, 2:] = False
    for params in (
        PARAMS._replace(min_looks=LOOKS + 1),
        PARAMS._replace(speed=SpeedGate(500.0, 900.0)),
        PARAMS._replace(member_m=1e-6),
    ):
        tracks, info = start(with_nan_behind_masks(scan), table, params)
        assert not tracks.mask.any()
        np.testing.assert_array_equal(info.member, -1)
    assert start(scan, table, PARAMS._replace(min_looks=LOOKS))[0].mask[:2].all()


def test_a_target_faster_at_times_is_followed_as_far_as_it_moves_evenly():
    scan, table, _ = random_scene(5)
    scan.mask[:, 1:] = False
    theta = float(table.theta_rad[0])
    scan.position_m[-1, 0] += 200.0 * np.array([math.sin(theta), -math.cos(theta)])
    _, info = start(scan, table, PARAMS)
    np.testing.assert_array_equal(info.member[0], [0] * (LOOKS - 1) + [-1])


def test_two_looks_are_enough_for_whom_two_are_enough():
    scan, table, _ = random_scene(6)
    scan.mask[:, 2:] = False
    scan = jax.tree.map(lambda x: x[:2], with_nan_behind_masks(scan))
    tracks, info = start(scan, table, PARAMS._replace(min_looks=2))
    np.testing.assert_array_equal(tracks.mask, [True, True, False])
    np.testing.assert_array_equal(info.member[:2], [[0, 0], [1, 1]])
    for target in range(2):
        time = scan.time_s + scan.delay_s[:, target]
        velocity = np.diff(scan.position_m[:, target], axis=0)[0] / (time[1] - time[0])
        end = scan.position_m[1, target] + (scan.time_s[1] - time[1]) * velocity
        np.testing.assert_allclose(tracks.mean[target, :2], end, atol=1.0)
        np.testing.assert_allclose(tracks.mean[target, 2:], velocity, atol=0.1)
    assert not start(scan, table, PARAMS)[0].mask.any()


def test_order_and_padding_change_nothing_but_indices():
    rng = np.random.default_rng(0)
    for seed in range(4):
        scan, table, _ = random_scene(seed)
        expected, info = start(scan, table, PARAMS)
        order = np.argsort(rng.random((LOOKS, SIZE + 2)), axis=1)

        def shuffle(x, fill, order=order):
            padded = np.pad(x, ((0, 0), (0, 2)) + ((0, 0),) * (x.ndim - 2), constant_values=fill)
            return np.stack([row[o] for row, o in zip(padded, order, strict=True)])

        other = scan._replace(
            position_m=shuffle(scan.position_m, np.nan),
            mask=shuffle(scan.mask, False),
            delay_s=shuffle(scan.delay_s, np.nan),
        )
        got, same = start(other, table, PARAMS)
        chex.assert_trees_all_close(got, expected, rtol=1e-10, atol=1e-9)
        np.testing.assert_allclose(same.smoothed_m, info.smoothed_m, rtol=1e-10)
        back = np.take_along_axis(order[None].repeat(3, 0), np.asarray(same.member)[..., None], 2)
        np.testing.assert_array_equal(np.where(same.member < 0, -1, back[..., 0]), info.member)


def test_other_values_do_not_compile_anew():
    once = jax.jit(chex.assert_max_traces(lambda *args: initiate(*args, nearest=4), n=1))
    for seed, member_m in enumerate((40.0, 60.0, 80.0)):
        scan, table, _ = random_scene(seed)
        assert once(scan, table, PARAMS._replace(member_m=member_m))[0].mask.any()


def test_gradients_agree_with_central_differences():
    scan, table, _ = random_scene(7)
    mask = np.arange(LOOKS * SIZE).reshape(LOOKS, SIZE) != 9
    hidden = np.where(mask, 0.0, np.nan)
    time_s = np.where(np.arange(LOOKS) == 2, np.nan, scan.time_s)
    valid = np.isfinite(time_s)

    def loss(position, delay, numbers):
        seen = Scan(time_s, valid, 100.0 * position + hidden[..., None], mask, delay_s=delay)  # pyright: ignore
        params = PARAMS._replace(sigma_m=10.0 * numbers[0], forgetting=0.9 * numbers[1])
        tracks, info = start(seen, table, params)
        ends = (tracks.mean[:2] / jnp.array([[100.0, 100.0, 10.0, 10.0]])).sum()
        return ends + (info.smoothed_m**2).sum() / 1e6 + tracks.covariance.sum() / 100.0

    arguments = (scan.position_m / 100.0, scan.delay_s, np.ones(2))
    assert_gradients_agree(loss, *arguments, rtol=1e-6, atol=1e-8)
    gradients = jax.jit(jax.grad(loss, argnums=(0, 1, 2)))(*arguments)
    assert all(np.abs(g).max() > 1e-3 for g in gradients)
    # Who is no member has no say.
    _, info = start(scan._replace(time_s=time_s, valid=valid, mask=mask), table, PARAMS)
    outside = np.ones((LOOKS, SIZE), bool)
    for members in np.asarray(info.member):
        for look, index in enumerate(members):
            outside[look, index] &= index < 0
    np.testing.assert_array_equal(gradients[0][outside], 0.0)
    np.testing.assert_array_equal(gradients[1][outside], 0.0)


@pytest.mark.parametrize("name", ["all masked", "all looks lost", "all in one place"])
def test_gradients_are_finite_on_degenerate_looks(name):
    scan, table, _ = random_scene(8)
    if name == "all masked":
        scan = with_nan_behind_masks(scan._replace(mask=np.zeros_like(scan.mask)))
    elif name == "all looks lost":
        scan = with_nan_behind_masks(scan._replace(valid=np.zeros_like(scan.valid)))
    else:
        scan = scan._replace(position_m=np.full_like(scan.position_m, 500.0))

    def loss(position, delay, sigma):
        seen = scan._replace(position_m=position, delay_s=delay)
        tracks, info = start(seen, table, PARAMS._replace(sigma_m=sigma))
        return tracks.mean.sum() + tracks.covariance.sum() + info.smoothed_m.sum()

    tracks, info = start(scan, table, PARAMS)
    assert all(np.isfinite(leaf).all() for leaf in jax.tree.leaves((tracks, info)))
    gradients = jax.jit(jax.grad(loss, argnums=(0, 1, 2)))(scan.position_m, scan.delay_s, 10.0)
    assert all(np.isfinite(g).all() for g in gradients)


def test_nearest_must_be_a_size():
    scan, table, _ = random_scene(0)
    with pytest.raises(ValueError, match="nearest: got 0, want an int ≥ 1"):
        initiate(scan, table, PARAMS, nearest=0)


def test_weights_decide_between_alternatives():
    # Two paths a look along one line; the weights say which is the target's.
    time_s = 2.0 * np.arange(4)
    there, back = 400.0 * np.arange(4), 1800.0 - 300.0 * np.arange(4)
    position = np.stack([np.stack([x, np.full(4, 80.0)], -1) for x in (there, back)], axis=1)
    line = Lines(np.array([80.0]), np.array([math.pi / 2]), np.array([4.0]), np.ones(1, bool))  # pyright: ignore[reportArgumentType]
    for share, velocity in (((1.0, 0.0), 200.0), ((0.0, 1.0), -150.0), ((0.3, 0.6), -150.0)):
        weight = np.broadcast_to(share, (4, 2))
        scans = Scan(time_s, np.ones(4, bool), position, np.ones((4, 2), bool), weight=weight)  # pyright: ignore
        tracks, info = start(scans, line, PARAMS)
        assert bool(tracks.mask[0])
        assert (np.asarray(info.member[0]) == (velocity < 0)).all()
        np.testing.assert_allclose(tracks.mean[0, 2:], [velocity, 0.0], atol=1.0)
