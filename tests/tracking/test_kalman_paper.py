"""The paper's Kalman tracker against its loop; its settings by hand; where it loses targets."""

import functools

import chex
import jax
import jax.numpy as jnp
import numpy as np
import pytest

from jaxtrack.tracking import (
    KalmanPaperParams,
    KalmanTrackerParams,
    LifecycleParams,
    kalman_paper,
    kalman_tracker,
)
from jaxtrack.types import Scan, Stage
from tests.metrics.differences import assert_gradients_agree
from tests.oracles import tracker as oracle

SLOTS, PLACES, LOOKS = 4, 5, 14
SIGMA, DT, P_DETECT, CLUTTER, GATE = 3.0, 0.5, 0.9, 1e-3, 9.21
PARAMS = KalmanPaperParams(SIGMA, DT, p_detect=P_DETECT, clutter_per_m2=CLUTTER)
P0 = np.diag([25.0, 25.0, 4.0, 4.0])


def scene(seed, *, far_m):
    """Return looks at two targets, the first some way from the origin, in clutter; one is none."""
    rng = np.random.default_rng(seed)
    time_s = np.cumsum(rng.uniform(0.4, 0.6, LOOKS))
    position = rng.uniform(-80.0, 80.0, (LOOKS, PLACES, 2))
    mask = rng.random((LOOKS, PLACES)) < 0.25
    starts = ((far_m, -far_m), (2.0, 1.0)), ((far_m - 25.0, 20.0), (-1.5, 1.0))
    for target, (start, velocity) in enumerate(starts):
        at = np.array(start) + time_s[:, None] * np.array(velocity)
        position[:, target] = at + SIGMA * rng.normal(size=(LOOKS, 2))
        mask[:, target] = rng.random(LOOKS) < P_DETECT
    position[~mask] = np.nan
    return Scan(time_s, np.arange(LOOKS) != 6, position, mask)  # pyright: ignore


@functools.cache
def compiled(start):
    def run(scans, params):
        tracker = kalman_paper(params, max_tracks=SLOTS, start=start)
        return jax.lax.scan(tracker.step, tracker.init(jax.random.key(0)), scans)

    return jax.jit(run)


def at_rest(state):
    return state, P0


def from_zero(state):
    """Return X₀ = 0, a step T_s, and the first detection, by the textbook."""
    f, q = oracle.motion(DT, 2 * SIGMA / DT**2)
    h = np.array([[1.0, 0.0, 0.0, 0.0], [0.0, 1.0, 0.0, 0.0]])
    p = f @ P0 @ f.T + q
    gain = p @ h.T @ np.linalg.inv(h @ p @ h.T + SIGMA**2 * np.eye(2))
    return gain @ state[:2], (np.eye(4) - gain @ h) @ p


@pytest.mark.parametrize(("start", "birth"), [("detection", at_rest), ("origin", from_zero)])
def test_tracks_equal_the_oracle(start, birth):
    confirmed = 0
    for seed in range(4):
        scans = scene(seed, far_m=15.0)
        _, info = compiled(start)(scans, PARAMS)
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
            looks, "greedy", slots=SLOTS, last=5, lives=(3, 5, 2), sigma=SIGMA,
            sigma_a=2 * SIGMA / DT**2, known=(P_DETECT, CLUTTER, GATE), birth=birth,
        )  # fmt: skip
        for k, slots in enumerate(expected):
            for slot, track in enumerate(slots):
                got = jax.tree.map(lambda x, k=k: x[k], info.tracks)
                assert bool(got.mask[slot]) == (track is not None), (seed, k, slot)
                if track is None:
                    continue
                identity, mean, covariance, stage, score, _ = track
                confirmed += stage >= Stage.CONFIRMED
                assert (got.identity[slot], got.stage[slot]) == (identity, stage)
                np.testing.assert_allclose(got.mean[slot], mean, rtol=1e-9, atol=1e-9)
                np.testing.assert_allclose(got.covariance[slot], covariance, rtol=1e-9, atol=1e-9)
                np.testing.assert_allclose(got.log_score[slot], score, rtol=1e-9, atol=1e-9)
    assert confirmed > 20


def still(place, looks=12):
    """Return looks at one target at rest, T_s apart, without noise."""
    position = np.broadcast_to(np.array(place), (looks, 1, 2)).copy()
    yes = np.ones((looks, 1), bool)
    return Scan(DT * np.arange(looks), yes[:, 0].copy(), position, yes)  # pyright: ignore


def test_settings_are_the_papers_as_worked_out_by_hand():
    # σ_W = 24 m/s²: Q has 9 m² for the position, 36 m²/s beside it and 144 m²/s² for the velocity.
    scans = still((44.0, -22.0), looks=1)
    for start, mean, block in (
        ("detection", (44.0, -22.0, 0.0, 0.0), [[25.0, 0.0], [0.0, 4.0]]),
        # P⁻ = [[35, 38], [38, 148]] and S = 44.
        (
            "origin",
            (35.0, -17.5, 38.0, -19.0),
            [[35 * 9 / 44, 38 * 9 / 44], [38 * 9 / 44, 148 - 38**2 / 44]],
        ),
    ):
        _, info = compiled(start)(scans, PARAMS)
        np.testing.assert_allclose(info.tracks.mean[0, 0], mean, atol=1e-12)
        expected = np.kron(np.array(block), np.eye(2))
        np.testing.assert_allclose(info.tracks.covariance[0, 0], expected, rtol=1e-12, atol=1e-12)


@pytest.mark.slow
def test_to_the_letter_a_distant_target_is_never_held():
    for start, place, held in (
        ("detection", (120.0, 80.0), True),
        ("origin", (120.0, 80.0), False),
        ("origin", (12.0, 8.0), True),
    ):
        _, info = compiled(start)(still(place), PARAMS)
        assert bool((info.tracks.stage >= Stage.CONFIRMED).any()) == held


def test_it_is_the_kalman_tracker_with_these_numbers_and_without_the_detections_covariances():
    scans = scene(0, far_m=15.0)
    same = KalmanTrackerParams(SIGMA, 24.0, P_DETECT, CLUTTER, 2.0, 5.0, GATE)
    tracker = kalman_tracker(same, max_tracks=SLOTS, associator="greedy")
    _, expected = jax.lax.scan(tracker.step, tracker.init(jax.random.key(0)), scans)
    own = scans._replace(covariance_m2=np.full((LOOKS, PLACES, 2, 2), 7.0))
    _, info = compiled("detection")(own, PARAMS)
    chex.assert_trees_all_close(info, expected, rtol=1e-9, atol=1e-9)


def test_looks_that_are_none_change_nothing_and_vmap_is_a_loop():
    several = [scene(seed, far_m=15.0) for seed in range(3)]
    together = jax.vmap(compiled("origin"), (0, None))(
        jax.tree.map(lambda *x: np.stack(x), *several), PARAMS
    )
    for n, scans in enumerate(several):
        alone = compiled("origin")(scans, PARAMS)
        both = jax.tree.map(lambda x, n=n: x[n], together[1].tracks), alone[1].tracks
        chex.assert_trees_all_close(*both, rtol=1e-9, atol=1e-9)
    before, none = (jax.tree.map(lambda x, k=k: x[k], alone[1].tracks) for k in (5, 6))
    chex.assert_trees_all_equal(before, none)


@pytest.mark.slow
@pytest.mark.parametrize("start", ["detection", "origin"])
def test_gradients_agree_with_central_differences(start):
    scans = scene(1, far_m=15.0)

    def loss(position, numbers):
        moved = scans._replace(position_m=jnp.where(scans.mask[..., None], position, jnp.nan))
        state, _ = compiled(start)(moved, PARAMS._replace(sigma_m=numbers[0], dt_s=numbers[1]))
        tracks = state.table.tracks
        return (jnp.where(tracks.mask[:, None], tracks.mean, 0.0) ** 2).sum() * 1e-3

    position = np.where(scans.mask[..., None], scans.position_m, 0.0)
    found = assert_gradients_agree(loss, position, np.array([SIGMA, DT]), rtol=1e-5, atol=1e-6)
    assert all(np.abs(g).max() > 1e-4 for g in found)


@pytest.mark.slow
def test_single_precision_stays_single():
    single = jax.tree.map(
        lambda x: x.astype(np.float32) if x.dtype == float else x, scene(0, far_m=15.0)
    )
    numbers = (np.float32(x) for x in PARAMS[:7])
    state, _ = compiled("origin")(single, KalmanPaperParams(*numbers, LifecycleParams()))
    for leaf in jax.tree.leaves(state.table):
        assert leaf.dtype != np.float64
        assert np.isfinite(leaf).all()


def test_what_cannot_be_is_named():
    with pytest.raises(ValueError, match=r"start: got 'zero', want one of"):
        kalman_paper(PARAMS, max_tracks=2, start="zero")
    with pytest.raises(ValueError, match=r"params.dt_s: got 0.0, want a positive"):
        kalman_paper(PARAMS._replace(dt_s=0.0), max_tracks=2)
    with pytest.raises(ValueError, match=r"params.sigma_m: got -1.0, want a positive"):
        kalman_paper(PARAMS._replace(sigma_m=-1.0), max_tracks=2)
    with pytest.raises(ValueError, match=r"associator: got 'best', want one of"):
        kalman_paper(PARAMS, max_tracks=2, associator="best")
