"""The Kalman tracker against its loop, and what every recursive estimator promises."""

import collections
import functools

import chex
import jax
import jax.numpy as jnp
import numpy as np
import pytest

from jaxtrack.association import ASSOCIATORS
from jaxtrack.numerics import scan_in_segments
from jaxtrack.tracking import KalmanTrackerParams, LifecycleParams, kalman_tracker, soft_lives
from jaxtrack.types import Scan, Stage
from tests.metrics.differences import assert_gradients_agree
from tests.oracles import tracker as oracle

SLOTS, PLACES, LOOKS = 4, 5, 14
SIGMA, SIGMA_A, P_DETECT, CLUTTER, GATE, BIRTH = 1.0, 0.3, 0.9, 1e-3, 9.21, 4.0
PARAMS = KalmanTrackerParams(SIGMA, SIGMA_A, P_DETECT, CLUTTER, BIRTH, gate=GATE)
EXCLUSIVE = ("greedy", "optimal", "jpda")


def scene(seed, *, looks=LOOKS, places=PLACES):
    """Return looks at two targets that come near each other, in clutter; one look is none."""
    rng = np.random.default_rng(seed)
    time_s = np.cumsum(rng.uniform(0.8, 1.2, looks))
    position = rng.uniform(0.0, 60.0, (looks, places, 2))
    mask = rng.random((looks, places)) < 0.25
    for target, (start, velocity) in enumerate(
        (((10.0, 20.0), (2.0, 1.0)), ((40.0, 22.0), (-1.5, 1.0)))
    ):
        at = np.array(start) + (time_s - time_s[0])[:, None] * np.array(velocity)
        position[:, target] = at + SIGMA * rng.normal(size=(looks, 2))
        mask[:, target] = rng.random(looks) < P_DETECT
    position[~mask] = np.nan
    valid = np.arange(looks) != 6
    return Scan(time_s, valid, position, mask)  # pyright: ignore[reportArgumentType]


traces = collections.Counter()


@functools.cache
def compiled(name):
    def run(scans, params, key):
        traces[name, scans.mask.shape] += 1
        tracker = kalman_tracker(params, max_tracks=SLOTS, associator=name)
        return jax.lax.scan(tracker.step, tracker.init(key), scans)

    return jax.jit(run)


def run(name, scans, params=PARAMS):
    return compiled(name)(scans, params, jax.random.key(0))


@pytest.mark.parametrize("name", EXCLUSIVE)
def test_tracks_equal_the_oracle(name):
    for seed in range(6):
        scans = scene(seed)
        _, info = run(name, scans)
        looks = [
            (
                float(scans.time_s[k]),
                bool(scans.valid[k]),
                [
                    tuple(z) if there else None
                    for z, there in zip(scans.position_m[k], scans.mask[k], strict=True)
                ],
            )
            for k in range(LOOKS)
        ]
        expected = oracle.run(
            looks, name, slots=SLOTS, last=5, lives=(3, 5, 2), sigma=SIGMA, sigma_a=SIGMA_A,
            known=(P_DETECT, CLUTTER, GATE), birth_speed=BIRTH,
        )  # fmt: skip
        confirmed = 0
        for k, slots in enumerate(expected):
            for slot, track in enumerate(slots):
                got = jax.tree.map(lambda x, k=k: x[k], info.tracks)
                assert bool(got.mask[slot]) == (track is not None), (seed, k, slot)
                if track is None:
                    continue
                identity, mean, covariance, stage, score, existence = track
                confirmed += stage >= Stage.CONFIRMED
                assert (got.identity[slot], got.stage[slot]) == (identity, stage)
                np.testing.assert_allclose(got.mean[slot], mean, rtol=1e-9, atol=1e-9)
                np.testing.assert_allclose(got.covariance[slot], covariance, rtol=1e-9, atol=1e-9)
                np.testing.assert_allclose(got.log_score[slot], score, rtol=1e-9, atol=1e-9)
                np.testing.assert_allclose(got.existence[slot], existence, rtol=1e-9, atol=1e-9)
        assert confirmed > 5


def test_order_and_padding_change_nothing():
    scans = scene(1)
    expected, _ = run("jpda", scans)
    order = np.random.default_rng(0).permutation(PLACES)
    shuffled = scans._replace(position_m=scans.position_m[:, order], mask=scans.mask[:, order])
    # Births of one look take slots in the order of the detections: tracks are told by their place.
    found, _ = run("jpda", shuffled)
    tables = []
    for state in (expected, found):
        tracks = state.table.tracks
        by_place = np.lexsort((tracks.mean[:, 0], ~tracks.mask))
        kept = tracks.mean, tracks.covariance, tracks.mask, tracks.stage, tracks.log_score
        tables.append(jax.tree.map(lambda x, order=by_place: x[order], kept))
    chex.assert_trees_all_close(*tables, rtol=1e-9, atol=1e-9)
    pad = lambda x, value: np.concatenate([x, np.full((LOOKS, 2, *x.shape[2:]), value)], axis=1)
    padded = scans._replace(position_m=pad(scans.position_m, np.nan), mask=pad(scans.mask, False))
    longer, _ = run("jpda", padded)
    chex.assert_trees_all_close(longer.table, expected.table, rtol=1e-9)


def test_extreme_looks_leave_finite_tables_and_empty_ones_no_tracks():
    full = scene(5)._replace(position_m=np.nan_to_num(scene(5).position_m))
    cases = {
        "full": full._replace(mask=np.ones_like(full.mask)),
        "empty": full._replace(mask=np.zeros_like(full.mask), position_m=full.position_m * np.nan),
        "coincident": full._replace(position_m=np.full_like(full.position_m, 7.0)),
        "frozen": full._replace(time_s=np.zeros(LOOKS)),
        "none": full._replace(valid=np.zeros(LOOKS, bool), time_s=np.full(LOOKS, np.nan)),
    }
    for name, case in cases.items():
        state, info = run("jpda", case)
        for leaf in jax.tree.leaves((state.table, info.tracks, info.weight)):
            assert np.isfinite(leaf).all(), name
        assert info.tracks.mask.any() == (name not in ("empty", "none")), name


def test_vmap_is_a_loop_and_other_values_do_not_trace_again():
    several = [scene(seed) for seed in range(3)]
    stacked = jax.tree.map(lambda *x: np.stack(x), *several)
    build = lambda scans: run("optimal", scans)[1].tracks
    together = jax.jit(jax.vmap(build))(stacked)
    for n, scans in enumerate(several):
        alone = run("optimal", scans)[1].tracks
        chex.assert_trees_all_close(
            jax.tree.map(lambda x, n=n: x[n], together), alone, rtol=1e-9, atol=1e-9
        )
    before = traces["optimal", (LOOKS, PLACES)]
    for factor in (1.1, 1.2):
        run("optimal", several[0], PARAMS._replace(sigma_m=factor, birth_sigma_m_s=4 * factor))
    assert traces["optimal", (LOOKS, PLACES)] == before


def still(looks, *, seen, valid):
    """Return looks at one target at rest, seen or not, a second apart."""
    position = np.full((looks, 2, 2), 7.0)
    mask = np.zeros((looks, 2), bool)
    mask[:, 0] = seen
    return Scan(np.arange(float(looks)), np.broadcast_to(valid, looks).copy(), position, mask)  # pyright: ignore


def test_a_minute_of_empty_looks_deletes_all_tracks_and_of_no_looks_none():
    looks = np.arange(70)
    for valid, left in ((True, 0), (looks < 10, 1)):
        scans = still(70, seen=looks < 10, valid=valid)
        state, info = run("optimal", scans)
        assert int(info.tracks.mask[9].sum()) == 1
        assert info.tracks.stage[9, 0] == Stage.CONFIRMED
        assert int(state.table.tracks.mask.sum()) == left
        assert int(state.table.next_identity) == 1
    # Looks that are none change nothing, whatever stands in them.
    assert int(info.tracks.stage[-1, 0]) == Stage.CONFIRMED
    chex.assert_trees_all_close(
        *(jax.tree.map(lambda x, k=k: x[k], info.tracks) for k in (9, 69)), rtol=0
    )


def test_what_the_sensor_cannot_see_is_no_miss():
    looks = np.arange(40)
    scans = still(40, seen=looks < 10, valid=True)
    sees = lambda mean, scan: jnp.where(scan.time_s < 10, 1.0, 0.0)
    tracker = kalman_tracker(PARAMS, max_tracks=2, associator="optimal", p_detect=sees)
    state, info = jax.jit(lambda s: jax.lax.scan(tracker.step, tracker.init(jax.random.key(0)), s))(
        scans
    )
    assert info.tracks.stage[-1].tolist() == [Stage.CONFIRMED, Stage.EMPTY]
    assert state.table.misses.tolist() == [0, 0]


def test_existence_falls_with_misses_after_however_many_hits():
    looks = np.arange(60)
    for dtype in (float, np.float32):
        params = KalmanTrackerParams(*map(dtype, PARAMS[:5]))
        scans = still(60, seen=looks < 50, valid=looks != 20)
        _, info = run("optimal", scans, params)
        existence = np.asarray(info.tracks.existence)[:, 0]
        assert existence[0] == 0.5
        assert existence[10] > 0.999
        assert existence[20] == existence[19]  # no look
        assert (np.diff(existence[49:54]) < 0).all()
        assert existence[53] < 0.1 < existence[50] < 0.95
        assert existence[54] == 0.0  # gone, after five misses
        assert ((existence >= 0) & (existence <= 1)).all()


def test_a_full_table_says_so():
    scans = scene(3)
    tracker = kalman_tracker(PARAMS, max_tracks=1, associator="greedy")
    _, info = jax.jit(lambda s: jax.lax.scan(tracker.step, tracker.init(jax.random.key(0)), s))(
        scans
    )
    assert info.full.any()
    assert not info.full[~scans.valid].any()


@pytest.mark.slow
def test_gradients_agree_with_central_differences():
    scans = scene(2)
    hidden = np.where(scans.mask, 0.0, np.nan)
    confirmed = np.asarray(run("jpda", scans)[0].table.tracks.stage) >= Stage.CONFIRMED

    def loss(position, numbers):
        params = KalmanTrackerParams(*numbers, gate=30.0)
        moved = scans._replace(position_m=position + hidden[..., None])
        state, _ = run("jpda", moved, params)
        mean = state.table.tracks.mean
        return (jnp.where(confirmed[:, None], mean, 0.0) ** 2).sum() * 1e-3

    position = np.where(scans.mask[..., None], scans.position_m, 0.0)
    numbers = np.array([SIGMA, SIGMA_A, P_DETECT, CLUTTER * 5, BIRTH])
    gradients = assert_gradients_agree(loss, position, numbers, rtol=1e-5, atol=1e-6)
    assert all(np.abs(g).max() > 1e-4 for g in gradients)


def test_ten_thousand_looks_leave_the_table_sound_in_single_precision():
    rng = np.random.default_rng(0)
    looks = 10_000
    time_s = np.arange(looks, dtype=np.float32)
    position = rng.uniform(0.0, 60.0, (looks, PLACES, 2)).astype(np.float32)
    position[:, 0] = 30.0 + rng.normal(size=(looks, 2))
    mask = rng.random((looks, PLACES)) < 0.3
    mask[:, 0] = rng.random(looks) < 0.9
    scans = Scan(time_s, rng.random(looks) < 0.95, position, mask)  # pyright: ignore
    single = KalmanTrackerParams(*map(np.float32, PARAMS[:5]))
    state, info = run("jpda", scans, single)
    for leaf in jax.tree.leaves((info.tracks, state.table)):
        if jnp.issubdtype(leaf.dtype, jnp.floating):
            assert leaf.dtype == np.float32
            assert np.isfinite(leaf).all()
    assert np.abs(np.asarray(state.table.tracks.covariance)).max() < 1e3
    identity, there = np.asarray(info.tracks.identity), np.asarray(info.tracks.mask)
    assert (identity[~there] == -1).all()
    # An identity lives in one slot, over looks without a gap.
    for slot in range(SLOTS):
        held = identity[there[:, slot], slot]
        assert (np.diff(held) >= 0).all()
    alive = [set(identity[there[:, slot], slot].tolist()) for slot in range(SLOTS)]
    assert sum(map(len, alive)) == len(set.union(*alive)) == int(state.table.next_identity)


def test_what_cannot_be_is_named():
    with pytest.raises(ValueError, match=r"associator: got 'best', want one of"):
        kalman_tracker(PARAMS, max_tracks=2, associator="best")
    with pytest.raises(ValueError, match=r"params.sigma_m: got -1.0, want a positive"):
        kalman_tracker(PARAMS._replace(sigma_m=-1.0), max_tracks=2)
    with pytest.raises(TypeError, match=r"max_tracks: got float"):
        kalman_tracker(PARAMS, max_tracks=2.0)  # pyright: ignore[reportArgumentType]
    with pytest.raises(ValueError, match=r"params.p_detect: got 1.5"):
        kalman_tracker(PARAMS._replace(p_detect=1.5), max_tracks=2)


def test_tracks_start_from_the_lifecycle_that_is_asked_for():
    scans = still(8, seen=True, valid=True)
    late = PARAMS._replace(lifecycle=LifecycleParams(confirm_hits=5))
    _, info = run("optimal", scans, late)
    assert info.tracks.stage[:, 0].tolist() == [1, 1, 1, 1, 2, 2, 2, 2]


def test_what_is_no_number_counts_as_none():
    clean = scene(4)
    there = np.argwhere(clean.mask & clean.valid[:, None])
    look, place = there[len(there) // 2]
    broken, masked = (jax.tree.map(np.copy, clean) for _ in range(2))
    broken.position_m[look, place] = np.nan
    masked.mask[look, place] = False
    broken.time_s[3], masked.valid[3] = np.nan, False
    (state, _), (expected, _) = (run("jpda", case) for case in (broken, masked))
    chex.assert_trees_all_close(state.table, expected.table, rtol=1e-12)


def test_a_scans_own_covariance_and_weight_count_and_a_new_track_starts_with_them():
    scans = still(1, seen=True, valid=True)
    own = np.broadcast_to(np.array([[4.0, 1.0], [1.0, 2.0]]), (1, 2, 2, 2))
    scans = scans._replace(covariance_m2=own, weight=np.array([[0.5, 1.0]]))
    for birth, expected in ((None, own[0, 0]), (3.0, 9.0 * np.eye(2))):
        params = PARAMS._replace(birth_sigma_m=birth)
        tracker = kalman_tracker(params, max_tracks=2, associator=ASSOCIATORS["greedy"])
        _, info = jax.lax.scan(tracker.step, tracker.init(jax.random.key(0)), scans)
        np.testing.assert_allclose(info.tracks.covariance[0, 0, :2, :2], expected)
        np.testing.assert_allclose(info.tracks.log_score[0, 0], np.log(0.5))
        assert info.candidates[0].tolist() == [True, False]
    none = scans._replace(weight=np.zeros((1, 2)))
    _, info = jax.lax.scan(tracker.step, tracker.init(jax.random.key(0)), none)
    assert not info.tracks.mask.any()


@pytest.mark.slow
def test_precision_is_that_of_the_parameters_whatever_the_scan_has():
    single = jax.tree.map(lambda x: x.astype(np.float32) if x.dtype == float else x, scene(0))
    for name in ("greedy", "jpda"):
        tracker = kalman_tracker(PARAMS, max_tracks=SLOTS, associator=name)
        one = jax.tree.map(lambda x: x[0], single)
        state, _ = tracker.step(tracker.init(jax.random.key(0)), one)
        assert state.table.tracks.mean.dtype == np.float64


@pytest.mark.parametrize("associator", ["optimal", "jpda", "pmht"])
def test_a_target_at_the_edge_of_sight_is_kept(associator):
    rng = np.random.default_rng(1)
    t = 0.5 * np.arange(120)
    path = np.stack([np.minimum(20 + t, 49.7), 0.5 * t], -1)
    seen = Scan(t, np.ones(120, bool), path[:, None] + rng.normal(size=(120, 1, 2)),
                rng.random((120, 1)) < 0.9)  # fmt: skip
    tracker = kalman_tracker(
        KalmanTrackerParams(1.0, 0.1, 0.9, 1e-4, birth_sigma_m_s=2.0),
        max_tracks=4,
        associator=associator,
        p_detect=lambda mean, scan: (mean[0] < 50.0).astype(mean.dtype),
    )
    run = jax.jit(lambda scans: jax.lax.scan(tracker.step, tracker.init(jax.random.key(0)), scans))
    tracks = run(seen)[1].tracks
    off_m = np.linalg.norm(np.asarray(tracks.mean)[..., :2] - path[:, None], axis=-1)
    near = (off_m < 4.0) & (np.asarray(tracks.stage) >= Stage.CONFIRMED)
    assert near[60:].any(1).all()


def test_what_no_tracker_can_have_is_refused_when_it_is_built():
    params = KalmanTrackerParams(1.0, 0.1, 0.9, 1e-4)
    with pytest.raises(ValueError, match="max_tracks: got 20, want at most 10 with jpda"):
        kalman_tracker(params, max_tracks=20)
    with pytest.raises(TypeError, match="p_detect: got float, want a function"):
        kalman_tracker(params, max_tracks=2, p_detect=0.5)


@pytest.mark.parametrize(
    ("name", "times"),
    [
        ("greedy", 3.0),
        pytest.param("optimal", 3.0, marks=pytest.mark.slow),
        pytest.param("jpda", 3.0, marks=pytest.mark.slow),
        pytest.param("belief_propagation", 3.5, marks=pytest.mark.slow),
        pytest.param("pmht", 3.0, marks=pytest.mark.slow),
    ],
)
def test_a_run_in_segments_is_the_run_and_its_gradient_takes_few_times_its_memory(name, times):
    scans = scene(0, looks=200, places=12)

    numbers = jnp.array([SIGMA, SIGMA_A, P_DETECT, CLUTTER, BIRTH])

    def loss(scan, numbers, position_m):
        params = KalmanTrackerParams(*numbers, gate=GATE)
        tracker = kalman_tracker(params, max_tracks=8, associator=name)
        looks = scans._replace(position_m=position_m)
        tracks = scan(tracker.step, tracker.init(jax.random.key(0)), looks)[1].tracks
        return jnp.where(tracks.mask[..., None], jnp.tanh(tracks.mean / 50.0), 0.0).mean(), tracks

    def compiled(of):
        return jax.jit(of).lower(numbers, scans.position_m).compile()

    def needed(program):
        sizes = program.memory_analysis()
        return sizes.temp_size_in_bytes + sizes.output_size_in_bytes

    plain, segmented = (
        compiled(jax.value_and_grad(functools.partial(loss, scan), (0, 1), has_aux=True))
        for scan in (jax.lax.scan, scan_in_segments)
    )
    (value, tracks), slopes = segmented(numbers, scans.position_m)
    (value_too, tracks_too), slopes_too = plain(numbers, scans.position_m)
    np.testing.assert_allclose(value, value_too, rtol=1e-13)
    np.testing.assert_array_equal(tracks.identity, tracks_too.identity)
    np.testing.assert_allclose(tracks.mean, tracks_too.mean, rtol=1e-11, atol=1e-11)
    for one, other in zip(jax.tree.leaves(slopes), jax.tree.leaves(slopes_too), strict=True):
        np.testing.assert_allclose(one, other, rtol=1e-7, atol=1e-11)
    alone = lambda scan: lambda *at: loss(scan, *at)[0]
    back = jax.grad(alone(scan_in_segments), (0, 1))
    assert needed(compiled(back)) < times * needed(compiled(alone(jax.lax.scan)))


@pytest.mark.parametrize("lives", ["soft", soft_lives])
def test_lives_that_are_none_are_refused(lives):
    with pytest.raises(TypeError, match=r"lives: got .*, want None or a function"):
        kalman_tracker(KalmanTrackerParams(1.0, 0.1, 0.9, 1e-4), max_tracks=3, lives=lives)
