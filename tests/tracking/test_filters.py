"""Filters in the Kalman tracker: with one target it is its filter; with several it is a tracker."""

import functools

import chex
import jax
import jax.numpy as jnp
import numpy as np
import pytest

from jaxtrack.association import Association, gate, update_mixture
from jaxtrack.filtering import extended, interacting, kalman, unscented
from jaxtrack.filtering.gaussian import Moments, Prior, recursion
from jaxtrack.filtering.polar import PolarParams
from jaxtrack.models import PolarScan, coordinated_turn, range_bearing, straight
from jaxtrack.tracking import (
    KalmanTrackerParams,
    interacting_filter,
    kalman_tracker,
    position_filter,
    range_bearing_filter,
    straight_filter,
)
from jaxtrack.types import Pose, Scan, Stage
from tests.metrics.differences import assert_gradients_agree

LOOKS, PLACES, SLOTS = 12, 3, 6
SIGMA, SIGMA_A, RANGE, BEARING = 1.0, 0.2, 1.5, 0.02
REST = (3.0, 3.0, 0.2)
TURN = coordinated_turn(SIGMA_A, 0.02)
MODELS = [straight(0.05, 0.2), TURN]
PROBABILITY, SWITCHING = np.array([0.7, 0.3]), np.array([[0.9, 0.1], [0.15, 0.85]])
MOUNT = (0.5, -0.3)
POLAR = ("extended", "unscented")
NAMES = ("straight", "turning", *POLAR, "interacting")


def filter_of(name):
    if name == "straight":
        return straight_filter(SIGMA, SIGMA_A, 3.0)
    if name == "turning":
        return position_filter(TURN, SIGMA, REST)
    if name == "interacting":
        return interacting_filter(MODELS, PROBABILITY, SWITCHING, SIGMA, REST)
    linearize = {"extended": extended, "unscented": unscented}[name].linearize
    return range_bearing_filter(TURN, RANGE, BEARING, REST, mount_m=MOUNT, linearize=linearize)


def single(name, prior):
    """Return the filter of one target that has the same numbers."""
    if name == "straight":
        return kalman.kalman(kalman.KalmanParams(prior, SIGMA_A, SIGMA))
    if name == "interacting":
        params = interacting.InteractingParams(prior, PROBABILITY, SWITCHING, SIGMA)
        return interacting.interacting(params, MODELS)
    if name == "turning":

        def move(mean, covariance, dt):
            linear = extended.linearize(lambda x: TURN.propagate(x, dt), mean, covariance)
            return linear._replace(excess=TURN.noise(dt))

        observe = lambda mean, covariance, scan: kalman.position_seen(mean, scan, SIGMA)
        return recursion(prior, move, observe)
    build = {"extended": extended.extended, "unscented": unscented.unscented}[name]
    return build(PolarParams(prior, RANGE, BEARING, MOUNT), TURN)


def scene(seed, *, polar, targets=2, clutter=True):
    """Return looks at targets that turn, the first around behind the sensor; one look is none."""
    rng = np.random.default_rng(seed)
    places = PLACES if clutter else targets
    time_s = np.cumsum(rng.uniform(0.8, 1.2, LOOKS))
    angle = np.pi - 0.35 + 0.07 * time_s
    at = np.stack([40 * np.cos(angle), 40 * np.sin(angle)], axis=1)
    every = [at, np.array([35.0, 20.0]) + np.array([-1.0, 1.5]) * time_s[:, None]][:targets]
    valid, mask = np.arange(LOOKS) != 6, np.ones((LOOKS, places), bool)
    if clutter:
        mask = rng.random((LOOKS, places)) < 0.85
    position = rng.uniform(-60.0, 60.0, (LOOKS, places, 2))
    for k, path in enumerate(every):
        position[:, k] = path
    if not polar:
        position = position + SIGMA * rng.normal(size=position.shape)
        return Scan(time_s, valid, np.where(mask[..., None], position, np.nan), mask)  # pyright: ignore
    pose = Pose(0.2 * time_s[:, None] * np.array([1.0, 0.5]), -0.05 * time_s)  # pyright: ignore
    see = jax.vmap(jax.vmap(range_bearing, (0, None, None)), (0, 0, None))
    native = np.array(see(position, pose, np.array(MOUNT)))
    native = native + rng.normal(size=native.shape) * [RANGE, BEARING]
    native[..., 1] = (native[..., 1] + np.pi) % (2 * np.pi) - np.pi
    native[~mask] = np.nan
    return PolarScan(time_s, valid, native[..., 0], native[..., 1], mask, pose)  # pyright: ignore


def drop(scans, looks):
    """Return looks in which nothing is seen at some."""
    mask = scans.mask.copy()
    mask[looks] = False
    return scans._replace(mask=mask)


@functools.cache
def compiled(name, associator):
    def run(scans, sure):
        params = KalmanTrackerParams(SIGMA, SIGMA_A, 0.9, 1e-4, gate=jnp.where(sure, 1e4, 12.0))
        tracker = kalman_tracker(
            params, max_tracks=SLOTS, associator=associator, filter=filter_of(name)
        )
        return jax.lax.scan(tracker.step, tracker.init(jax.random.key(0)), scans)

    return jax.jit(run)


@pytest.mark.parametrize("name", NAMES)
def test_with_one_target_the_tracker_is_its_filter(name):
    scans = drop(scene(0, polar=name in POLAR, targets=1, clutter=False), [4, 5])
    _, info = compiled(name, "greedy")(scans, True)
    assert info.tracks.mask[:, 0].all()
    assert not info.tracks.mask[:, 1:].any()
    first = jax.tree.map(lambda x: x[0], info.tracks)
    prior = Prior(first.mean[0], first.covariance[0], first.time_s)
    alone = single(name, prior)
    rest = jax.tree.map(lambda x: x[1:], scans)
    _, expected = jax.jit(
        lambda rest: jax.lax.scan(alone.step, alone.init(jax.random.key(0)), rest)
    )(rest)
    mean, covariance = expected.filtered
    np.testing.assert_allclose(info.tracks.mean[1:, 0], mean, rtol=1e-9, atol=1e-9)
    np.testing.assert_allclose(info.tracks.covariance[1:, 0], covariance, rtol=1e-9, atol=1e-9)
    if name == "interacting":
        got = info.beliefs.probability[1:, 0]
        np.testing.assert_allclose(got, expected.probability, rtol=1e-9, atol=1e-12)
    if name in POLAR:  # the bearing went around
        assert np.ptp(scans.bearing_rad[scans.mask]) > 6


def by_place(tracks):
    """Return confirmed tables whose slots are sorted by where the tracks are."""
    order = np.lexsort((tracks.mean[:, 0], ~tracks.mask))
    kept = tracks.mean, tracks.covariance, tracks.mask, tracks.stage, tracks.log_score
    return jax.tree.map(lambda x: x[order], kept)


@pytest.mark.slow
@pytest.mark.parametrize("name", ["extended", "interacting"])
def test_order_padding_and_what_is_no_look_change_nothing(name):
    scans = scene(2, polar=name in POLAR)
    state, info = compiled(name, "jpda")(scans, False)
    tracks = state.table.tracks
    assert (tracks.stage >= Stage.CONFIRMED).sum() >= 2
    for leaf in jax.tree.leaves((state.table, state.beliefs, info.weight)):
        assert np.isfinite(leaf).all()

    order = np.random.default_rng(0).permutation(PLACES)
    fields = {"range_m", "bearing_rad", "position_m", "mask"} & set(scans._fields)
    shuffled = scans._replace(**{field: getattr(scans, field)[:, order] for field in fields})
    found, _ = compiled(name, "jpda")(shuffled, False)
    chex.assert_trees_all_close(by_place(found.table.tracks), by_place(tracks), atol=1e-8)

    def padded(x):
        empty = False if x.dtype == bool else np.nan
        return np.concatenate([x, np.full((LOOKS, 2, *x.shape[2:]), empty)], axis=1)

    longer = scans._replace(**{field: padded(getattr(scans, field)) for field in fields})
    found, _ = compiled(name, "jpda")(longer, False)
    chex.assert_trees_all_close(found.table.tracks, tracks, rtol=1e-8, atol=1e-8)

    # The seventh look is none: its numbers, and the table at it, do not count.
    broken = jax.tree.map(np.copy, scans)
    for field in fields - {"mask"} | {"time_s"}:
        getattr(broken, field)[6] = np.nan
    if name in POLAR:
        broken.pose.heading_rad[6] = np.nan
    found, info = compiled(name, "jpda")(broken, False)
    chex.assert_trees_all_close(found.table.tracks, tracks, rtol=1e-12)
    chex.assert_trees_all_close(*(jax.tree.map(lambda x, k=k: x[k], info.beliefs) for k in (5, 6)))


@pytest.mark.slow
@pytest.mark.parametrize("name", POLAR)
def test_gates_and_densities_are_those_of_range_and_bearing(name):
    rng = np.random.default_rng(5)
    scan = jax.tree.map(lambda x: x[9], drop(scene(3, polar=True), []))
    scan = scan._replace(mask=np.ones(PLACES, bool), range_m=np.array([38.0, 45.0, 41.0]),
                         bearing_rad=np.array([3.1, -3.1, 2.9]))  # fmt: skip
    root = rng.normal(size=(2, 5, 5)) * 0.7 + np.eye(5)
    covariance = root @ root.swapaxes(1, 2)
    mean = np.array([[-38.0, 2.0, 0.3, -1.0, 0.1], [-40.0, -4.0, 0.0, 1.0, 0.0]])
    of = filter_of(name)
    predicted = of.measure(Moments(mean, covariance), scan, np.ones(2, bool))
    gated = gate(predicted, of.look(scan), 1e9)
    noise = np.diag([RANGE**2, BEARING**2])
    module = {"extended": extended, "unscented": unscented}[name]
    for t in range(2):
        measure = lambda state: range_bearing(state, scan.pose, MOUNT)
        wrap = lambda a, b: jnp.stack([a[0] - b[0], (a[1] - b[1] + np.pi) % (2 * np.pi) - np.pi])
        linear = module.linearize(measure, mean[t], covariance[t], wrap)
        s = linear.matrix @ covariance[t] @ linear.matrix.T + linear.excess + noise
        area = abs(np.linalg.det(linear.matrix[:, :2]))  # m rad a square metre
        for n in range(PLACES):
            z = np.array([scan.range_m[n], scan.bearing_rad[n]])
            v = np.asarray(wrap(z, linear.value))
            d2 = v @ np.linalg.solve(s, v)
            density = np.exp(-d2 / 2) / np.sqrt(np.linalg.det(2 * np.pi * s)) * area
            np.testing.assert_allclose(gated.squared_distance[t, n], d2, rtol=1e-9)
            np.testing.assert_allclose(gated.density_per_m2[t, n], density, rtol=1e-9)


@pytest.mark.slow
def test_models_are_weighed_by_the_detections_that_are_the_tracks():
    rng = np.random.default_rng(1)
    of = filter_of("interacting")
    mean = rng.normal(size=(1, 2, 5))
    root = 0.3 * rng.normal(size=(1, 2, 5, 5)) + np.eye(5)
    covariance, chance = root @ root.swapaxes(2, 3), np.array([[0.6, 0.4]])
    look = Scan(np.array(0.0), np.array(True), rng.normal(size=(2, 2)), np.ones(2, bool))
    beliefs = type(of.start(look))(mean, covariance, chance)
    predicted = of.measure(beliefs, look, np.ones(1, bool))
    beta, miss = np.array([0.5, 0.2]), 0.3
    found = Association(jnp.asarray(beta[None]), jnp.array([miss]), jnp.array(True))
    after = of.update(beliefs, predicted, look, found, update_mixture)
    expected = miss * chance[0]
    for i in range(2):
        n = np.zeros(2)
        for k in range(2):
            s = covariance[0, k, :2, :2] + SIGMA**2 * np.eye(2)
            v = look.position_m[i] - mean[0, k, :2]
            n[k] = np.exp(-v @ np.linalg.solve(s, v) / 2) / np.sqrt(np.linalg.det(s))
        expected = expected + beta[i] * chance[0] * n / (chance[0] @ n)
    np.testing.assert_allclose(after.probability[0], expected, rtol=1e-12)
    np.testing.assert_allclose(after.probability.sum(), 1.0)


@pytest.mark.slow
@pytest.mark.parametrize("name", ["unscented", "interacting"])
def test_gradients_agree_with_central_differences(name):
    scans = jax.tree.map(lambda x: x[:5], scene(4, polar=name in POLAR))
    fields = ["range_m", "bearing_rad"] if name in POLAR else ["position_m"]
    values = [np.nan_to_num(getattr(scans, field)) for field in fields]
    hidden = np.where(scans.mask, 0.0, np.nan)

    def loss(*values):
        lifted = {
            field: x + hidden.reshape(hidden.shape + (1,) * (x.ndim - 2))
            for field, x in zip(fields, values, strict=True)
        }
        state, _ = compiled(name, "jpda")(scans._replace(**lifted), False)
        tracks = state.table.tracks
        return jnp.where(tracks.mask[:, None], tracks.mean[:, :4], 0.0).sum()

    assert_gradients_agree(loss, *values, rtol=1e-5, atol=1e-6)


@pytest.mark.slow
def test_single_precision_stays_and_is_finite_also_where_a_target_passes_the_sensor():
    scans = scene(1, polar=True)
    scans = scans._replace(range_m=np.where(np.arange(LOOKS)[:, None] > 8, 0.0, scans.range_m))
    single = jax.tree.map(lambda x: x.astype(np.float32) if x.dtype == float else x, scans)
    for name in POLAR:
        params = KalmanTrackerParams(*map(np.float32, (SIGMA, SIGMA_A, 0.9, 1e-4)))
        tracker = kalman_tracker(
            params, max_tracks=SLOTS, associator="optimal", filter=filter_of(name)
        )
        run = lambda s, tracker=tracker: jax.lax.scan(
            tracker.step, tracker.init(jax.random.key(0)), s
        )
        state, info = jax.jit(run)(single)
        for leaf in jax.tree.leaves((state.table, info.tracks, info.weight)):
            assert leaf.dtype != np.float64
            assert np.isfinite(leaf).all()


def test_what_cannot_be_is_named():
    with pytest.raises(ValueError, match=r"sigma_m: got -1.0, want a positive"):
        position_filter(TURN, -1.0, REST)
    with pytest.raises(ValueError, match=r"sigma_bearing_rad: got 0.0, want a positive"):
        range_bearing_filter(TURN, 1.0, 0.0, REST)
    with pytest.raises(ValueError, match=r"probability: got shape \[3\], want \[2\]"):
        interacting_filter(MODELS, np.ones(3) / 3, SWITCHING, SIGMA, REST)
