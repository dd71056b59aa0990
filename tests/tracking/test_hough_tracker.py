"""The tracker on window estimates against a loop, and what any user may rely on."""

import functools

import chex
import jax
import jax.numpy as jnp
import numpy as np
import pytest

from jaxtrack.metrics import nees
from jaxtrack.models import look_times
from jaxtrack.tracking import HoughTrackerParams, LifecycleParams, hough_tracker
from jaxtrack.types import Scan, Stage, Tracks
from tests.metrics.differences import assert_gradients_agree
from tests.oracles import hough_tracker as oracle

SIGMA_M, WINDOW, SLOTS, LAST, LOOKS, PLACES = 2.0, 5, 4, 4, 24, 5
LIVES, SCORE = (1, 4, 2), 4.0
PARAMS = HoughTrackerParams(0.05, 18.5, LifecycleParams(LIVES[0], SCORE, *LIVES[1:]))


def lines(scans):
    """Return a least-squares line through each place's detections, where there are three."""
    dt, end = look_times(scans)
    seen = (scans.mask & scans.valid[:, None]).astype(dt.dtype)  # [W, N]
    place = jnp.where(seen[..., None] > 0, scans.position_m, 0.0)
    s0, s1, s2 = ((seen * dt[:, None] ** k).sum(0) for k in (0, 1, 2))
    enough = seen.sum(0) >= 3
    determinant = jnp.where(enough, s0 * s2 - s1**2, 1.0)
    y0, y1 = (place.sum(0), (dt[:, None, None] * place).sum(0))
    here = (s2[:, None] * y0 - s1[:, None] * y1) / determinant[:, None]
    speed = (s0[:, None] * y1 - s1[:, None] * y0) / determinant[:, None]
    block = jnp.stack([jnp.stack([s2, -s1], -1), jnp.stack([-s1, s0], -1)], -2)
    unit = jnp.eye(2, dtype=dt.dtype)
    spread = jnp.einsum("nab,ij->naibj", block / determinant[:, None, None], unit)
    number = jnp.arange(enough.shape[0], dtype=jnp.int32)
    return Tracks(
        end,
        jnp.concatenate([here, speed], -1),
        jnp.asarray(SIGMA_M, dt.dtype) ** 2 * spread.reshape(-1, 4, 4),
        enough,
        number,
        jnp.full_like(number, Stage.TENTATIVE),
        seen.sum(0) / WINDOW,
        seen.sum(0),
    ), enough.sum()


def scene(seed, *, looks=LOOKS, places=PLACES, p_seen=0.7, p_valid=0.85):
    """Return looks at one straight target a place; some start late, some end early."""
    rng = np.random.default_rng(seed)
    time = 2.0 * np.arange(looks) + 5.0
    start, speed = rng.uniform(-200, 200, (places, 2)), rng.uniform(-3, 3, (places, 2))
    truth = start + speed * time[:, None, None]
    position = truth + SIGMA_M * rng.normal(size=truth.shape)
    born, gone = rng.integers(0, looks // 3, places), rng.integers(looks // 2, looks + 9, places)
    step = np.arange(looks)[:, None]
    mask = (rng.random((looks, places)) < p_seen) & (step >= born) & (step < gone)
    position[~mask] = np.nan
    return Scan(time, rng.random(looks) < p_valid, position, mask), truth, speed


@functools.cache
def compiled(dtype=np.float64):
    place = jnp.zeros((PLACES, 2), dtype)
    like = Scan(place[0, 0], jnp.array(True), place, jnp.zeros(PLACES, bool))

    def run(scans, params):
        tracker = hough_tracker(
            lines, params, like=like, window=WINDOW, max_tracks=SLOTS, confirm_looks=LAST
        )
        return jax.lax.scan(tracker.step, tracker.init(jax.random.key(0)), scans)

    return jax.jit(run)


def run(scans, params=PARAMS):
    return compiled()(scans, params)


@pytest.mark.parametrize("seed", range(8))
def test_agrees_with_the_loop(seed):
    scans, _, _ = scene(seed)
    lives = (1, *LIVES[1:]) if seed % 2 else (3, *LIVES[1:])
    _, info = run(scans, PARAMS._replace(lifecycle=LifecycleParams(lives[0], SCORE, *lives[1:])))
    looks = [
        (t, v, [tuple(z) if m else None for z, m in zip(zs, ms, strict=True)])
        for t, v, zs, ms in zip(*scans[:4], strict=True)
    ]
    options = {"gate": PARAMS.gate, "sigma": SIGMA_M, "sigma_a": PARAMS.sigma_a_m_s2}
    expected = oracle.run(
        looks, window=WINDOW, slots=SLOTS, last=LAST, lives=lives, score=SCORE, **options
    )
    assert any(track is not None for row in expected for track in row)
    tracks = jax.tree.map(np.asarray, info.tracks)
    for look, row in enumerate(expected):
        for slot, track in enumerate(row):
            assert tracks.mask[look, slot] == (track is not None)
            if track is None:
                continue
            identity, mean, covariance, stage = track
            assert tracks.identity[look, slot] == identity
            assert tracks.stage[look, slot] == stage
            np.testing.assert_allclose(tracks.mean[look, slot], mean, rtol=1e-10, atol=1e-9)
            np.testing.assert_allclose(
                tracks.covariance[look, slot], covariance, rtol=1e-9, atol=1e-11
            )


@pytest.mark.slow
def test_windows_that_share_looks_do_not_make_it_sure_of_itself():
    """Over many runs the mean NEES of four states is four, and errors are below a window's own."""
    scans, truth, speed = zip(
        *(scene(seed, looks=20, p_seen=0.9, p_valid=1.0) for seed in range(150)), strict=True
    )
    many = jax.tree.map(lambda *x: np.stack(x), *scans)
    still = PARAMS._replace(sigma_a_m_s2=0.0)
    _, info = jax.vmap(compiled(), (0, None))(many, still)
    one = jax.tree.map(lambda x: x[3], info.tracks)
    chex.assert_trees_all_close(one, run(scans[3], still)[1].tracks, rtol=1e-9, atol=1e-9)
    squared = jax.jit(jnp.vectorize(lambda *x: nees(*x).squared, signature="(s),(s,s),(s)->()"))
    slots = np.arange(SLOTS)
    agreed, ours, windows = [], [], []
    for trial in range(len(scans)):
        mean, owner = np.asarray(info.tracks.mean[trial]), np.asarray(info.owner[trial])
        state = np.concatenate(
            [truth[trial], np.broadcast_to(speed[trial], truth[trial].shape)], -1
        )
        gap = np.linalg.norm(mean[:, :, None, :2] - state[:, None, :, :2], axis=-1)
        true = np.take_along_axis(state, gap.argmin(-1)[..., None], axis=1)
        mine = owner[:, None, :] == slots[:, None]
        there = np.asarray(info.tracks.mask[trial]) & mine.any(-1)
        there[:14] = False  # old enough to know of two windows and more
        found = np.take_along_axis(
            np.asarray(info.estimates.mean[trial]), mine.argmax(-1)[..., None], axis=1
        )
        agreed.append(np.asarray(squared(mean, info.tracks.covariance[trial], true))[there])
        ours.append(((mean - true)[there][:, :2] ** 2).sum(-1))
        windows.append(((found - true)[there][:, :2] ** 2).sum(-1))
    # Estimates of one run are alike: the runs' own means are what is independent.
    each = np.array([x.mean() for x in agreed if len(x)])
    assert abs(each.mean() - 4) < 3 * each.std(ddof=1) / np.sqrt(len(each))
    assert np.concatenate(ours).mean() < 0.6 * np.concatenate(windows).mean()


def test_invalid_looks_change_nothing_and_valid_empty_ones_end_everything():
    scans, _, _ = scene(1, p_valid=1.0)
    state, _ = run(scans)
    assert state.table.tracks.mask.any()
    blind = scans._replace(valid=np.zeros(LOOKS, bool), time_s=scans.time_s + 100.0)
    more = jax.tree.map(lambda a, b: np.concatenate([a, b]), scans, blind)
    same, _ = run(more)
    chex.assert_trees_all_equal(same.table, state.table)
    empty = scans._replace(mask=np.zeros_like(scans.mask), time_s=scans.time_s + 100.0)
    ended, info = run(jax.tree.map(lambda a, b: np.concatenate([a, b]), scans, empty))
    assert not ended.table.tracks.mask.any()
    assert ended.table.next_identity == state.table.next_identity
    assert np.isfinite(info.tracks.mean).all()


def test_a_full_table_says_so_and_identities_are_never_used_again():
    again = [scene(seed, looks=60)[0] for seed in range(3, 9)]
    joined = jax.tree.map(lambda *x: np.concatenate(x), *again)
    joined = joined._replace(time_s=2.0 * np.arange(len(joined.time_s)))
    _, info = run(joined)
    assert info.full.any()
    identity, mask = np.asarray(info.tracks.identity), np.asarray(info.tracks.mask)
    for number in np.unique(identity[mask]):
        looks, slots = np.nonzero((identity == number) & mask)
        assert len(set(slots)) == 1
        assert looks.max() - looks.min() + 1 == len(looks)
    assert (identity[~mask] == -1).all()


def test_misses_count_only_where_the_sensor_sees():
    scans, _, _ = scene(1, p_valid=1.0)
    like = jax.tree.map(lambda x: jnp.asarray(x[0]), scans)
    empty = scans._replace(mask=np.zeros_like(scans.mask), time_s=scans.time_s + 100.0)
    both = jax.tree.map(lambda a, b: np.concatenate([a, b]), scans, empty)

    def blind_after(mean, scan):
        return jnp.where(scan.time_s < 90.0, 1.0, 0.0)

    tracker = hough_tracker(
        lines, PARAMS, like=like, window=WINDOW, max_tracks=SLOTS, p_detect=blind_after
    )
    state, _ = jax.lax.scan(tracker.step, tracker.init(jax.random.key(0)), both)
    assert state.table.tracks.mask.any()


def test_float32_stays_float32():
    scans, _, _ = scene(0)
    single = jax.tree.map(lambda x: x.astype(np.float32) if x.dtype == float else x, scans)
    _, info = compiled(np.float32)(single, PARAMS)
    assert info.tracks.mean.dtype == np.float32
    np.testing.assert_array_equal(info.tracks.mask, run(scans)[1].tracks.mask)


def poisoned(scans):
    """What `lines` finds, with NaN where there is none."""
    found, count = lines(scans)
    wild = lambda x: jnp.where(found.mask.reshape(-1, *(1,) * (x.ndim - 1)), x, jnp.nan)
    mean, covariance, score = map(wild, (found.mean, found.covariance, found.log_score))
    return found._replace(mean=mean, covariance=covariance, log_score=score), count


@pytest.mark.slow
def test_gradients_agree_with_central_differences_whatever_masked_estimates_hold():
    scans, _, _ = scene(2)
    like = jax.tree.map(lambda x: jnp.asarray(x[0]), scans)
    tracker = hough_tracker(
        poisoned, PARAMS, like=like, window=WINDOW, max_tracks=SLOTS, confirm_looks=LAST
    )

    def loss(position):
        looks = scans._replace(position_m=jnp.where(scans.mask[..., None], position, jnp.nan))
        _, info = jax.lax.scan(tracker.step, tracker.init(jax.random.key(0)), looks)
        return jnp.sin(info.tracks.mean[-1] / 50.0).sum()

    assert_gradients_agree(loss, jnp.nan_to_num(jnp.asarray(scans.position_m)))


def test_a_look_without_a_time_is_none():
    scans, _, _ = scene(0, p_valid=1.0)
    broken, blind = (jax.tree.map(np.copy, scans) for _ in range(2))
    broken.time_s[12], blind.valid[12] = np.nan, False
    (found, _), (expected, _) = run(broken), run(blind)
    chex.assert_trees_all_close(found.table, expected.table, rtol=1e-12)
    chex.assert_trees_all_close(found.past, expected.past, rtol=1e-12)


@pytest.mark.parametrize(
    ("change", "word"),
    [
        ({"gate": 0.0}, "params.gate: got 0"),
        ({"sigma_a_m_s2": -1.0}, "params.sigma_a_m_s2: got -1"),
        ({"gate": np.ones(2)}, "params.gate: got shape"),
    ],
)
def test_what_cannot_be_is_named(change, word):
    like = jax.tree.map(lambda x: jnp.asarray(x[0]), scene(0)[0])
    with pytest.raises(ValueError, match=word):
        hough_tracker(lines, PARAMS._replace(**change), like=like, window=3, max_tracks=2)
