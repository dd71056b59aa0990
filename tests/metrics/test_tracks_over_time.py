"""OSPA over time, OSPA(2) and the layout of identities, against loops and the axioms."""

import functools

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from jaxtrack.metrics import ospa2, ospa2_over_time, ospa_over_time, trajectories
from jaxtrack.types import Tracks, Truth
from tests.oracles import ospa2 as oracle
from tests.oracles.ospa import ospa as ospa_oracle

LOOKS, ESTIMATES, TRUTHS = 5, 4, 4
few = settings(max_examples=25, deadline=None, derandomize=True, database=None)


@functools.cache
def jitted():
    return jax.jit(lambda x, xm, y, ym, c, p: ospa2(x, xm, y, ym, cutoff=c, order=p))


def random_tracks(rng, columns=ESTIMATES, scale=6.0, lattice=False):
    """Return [T, I, 2] tracks that come and go, NaN where there are none."""
    start = rng.normal(scale=scale, size=(1, columns, 2))
    state = start + np.cumsum(rng.normal(scale=0.3 * scale, size=(LOOKS, columns, 2)), axis=0)
    state = np.round(state / 3.0) * 3.0 if lattice else state
    mask = (rng.random((LOOKS, columns)) < 0.7) & (rng.random(columns) < 0.8)[None, :]
    return np.where(mask[..., None], state, np.nan), mask


@few
@given(
    st.integers(0, 2**32 - 1),
    st.sampled_from((2.0, 10.0, 40.0)),
    st.sampled_from((1.0, 1.5, 2.0)),
    st.booleans(),
)
def test_ospa2_equals_brute_force_in_any_order_and_padding(seed, cutoff, order, lattice):
    rng = np.random.default_rng(seed)
    (x, xm), (y, ym) = (random_tracks(rng, lattice=lattice) for _ in range(2))
    score = jitted()(x, xm, y, ym, cutoff, order)
    wanted = oracle.ospa2(oracle.tracks_of(x, xm), oracle.tracks_of(y, ym), cutoff, order)
    np.testing.assert_allclose(score, wanted, rtol=1e-11, atol=1e-12)
    columns, looks = rng.permutation(ESTIMATES), rng.permutation(LOOKS)
    moved = x[looks][:, columns], xm[looks][:, columns], y[looks], ym[looks]
    np.testing.assert_allclose(jitted()(*moved, cutoff, order), score, rtol=1e-11, atol=1e-12)
    xm[:, 0] = False  # a column without a track is no track, whatever stands in it
    shorter = oracle.ospa2(
        oracle.tracks_of(x[:, 1:], xm[:, 1:]), oracle.tracks_of(y, ym), cutoff, order
    )
    np.testing.assert_allclose(
        jitted()(x, xm, y, ym, cutoff, order), shorter, rtol=1e-11, atol=1e-12
    )


@pytest.mark.parametrize("order", [1.0, 2.0])
def test_ospa2_is_a_metric(order):
    rng = np.random.default_rng(3)
    trials = 400
    # Few places, which tracks share, or else the triangle is never nearly flat.
    drawn = [[random_tracks(rng, scale=2.0, lattice=True) for _ in range(trials)] for _ in range(3)]
    (x, xm), (y, ym), (z, zm) = ([np.stack(part) for part in zip(*d, strict=True)] for d in drawn)
    score = jax.jit(jax.vmap(lambda *sets: jitted()(*sets, 6.0, order).distance))
    there, back = score(x, xm, y, ym), score(y, ym, x, xm)
    np.testing.assert_allclose(there, back, rtol=1e-12, atol=1e-12)
    np.testing.assert_array_equal(score(x, xm, x, xm), 0.0)
    assert np.all(score(x, xm, z, zm) <= there + score(y, ym, z, zm) + 1e-10)
    x[:, :, 0], xm[:, :, 0] = 1.0, True
    y, ym = x.copy(), xm.copy()
    y[:, 0, 0] += 1e-3
    assert np.all(score(x, xm, y, ym) > 0)


def test_ospa2_over_time_is_ospa2_of_each_window():
    rng = np.random.default_rng(5)
    (x, xm), (y, ym) = random_tracks(rng), random_tracks(rng)
    run = jax.jit(
        lambda *sets: ospa2_over_time(
            *sets, cutoff=8.0, order=2.0, window=3
        )  # as many as a run has
    )
    curve = np.stack(run(x, xm, y, ym), axis=-1)
    for look in range(LOOKS):
        of = slice(max(look - 2, 0), look + 1)
        tracks = [oracle.tracks_of(a[of], m[of]) for a, m in ((x, xm), (y, ym))]
        np.testing.assert_allclose(curve[look], oracle.ospa2(*tracks, 8.0, 2.0), atol=1e-12)


@few
@given(st.integers(0, 2**32 - 1), st.integers(1, 8))
def test_identities_are_laid_out_as_by_a_loop(seed, names):
    rng = np.random.default_rng(seed)
    state = rng.normal(size=(LOOKS, 3, 2))
    identity = np.stack([rng.permutation(max(names, 3))[:3] for _ in range(LOOKS)]) * 5 - 5
    mask = rng.random((LOOKS, 3)) < 0.6
    state[~mask] = np.nan
    found = jax.jit(lambda *table: trajectories(*table, identities=4))(state, mask, identity)
    wanted = oracle.trajectories(state, mask, identity, 4)
    for ours, theirs in zip(found, wanted, strict=True):
        np.testing.assert_array_equal(ours, theirs)


def test_without_tracks_every_column_is_empty():
    none = np.zeros((LOOKS, 0, 2)), np.zeros((LOOKS, 0), bool), np.zeros((LOOKS, 0), np.int32)
    found = jax.jit(lambda *table: trajectories(*table, identities=2))(*none)
    assert found.state.shape == (LOOKS, 2, 2)
    assert found.identity.tolist() == [-1, -1]
    assert not found.mask.any()
    assert not found.state.any()
    assert not found.overflow


def test_ospa_over_time_is_that_of_each_look():
    rng = np.random.default_rng(1)
    mean, state = rng.normal(scale=4.0, size=(2, LOOKS, 3, 4))
    mask, present = rng.random((2, LOOKS, 3)) < 0.7
    number = np.zeros((LOOKS, 3), int)
    time_s = np.arange(LOOKS) * 1.0
    tracks = Tracks(time_s, mean, np.zeros((LOOKS, 3, 4, 4)), mask, number, number, mean, mean)
    truth = Truth(time_s, state, present)
    scores = jax.jit(lambda a, b: ospa_over_time(a, b, cutoff_m=5.0, cutoff_m_s=3.0, order=2.0))(
        tracks, truth
    )
    for what, of, cutoff in (
        (scores.position, slice(0, 2), 5.0),
        (scores.velocity, slice(2, 4), 3.0),
    ):
        for t in range(LOOKS):
            wanted = ospa_oracle(mean[t, mask[t]][:, of], state[t, present[t]][:, of], cutoff, 2.0)
            np.testing.assert_allclose([part[t] for part in what], wanted, atol=1e-12)


def test_errors_name_the_argument():
    x, mask = jnp.zeros((3, 2, 2)), jnp.ones((3, 2), bool)
    with pytest.raises(ValueError, match="truths: got shape"):
        ospa2(x, mask, x[:2], mask[:2], cutoff=1.0, order=1.0)
    with pytest.raises(ValueError, match="estimates_mask: got shape"):
        ospa2(x, mask[:, :1], x, mask, cutoff=1.0, order=1.0)
    with pytest.raises(ValueError, match="order: got"):
        ospa2(x, mask, x, mask, cutoff=1.0, order=0.5)
    with pytest.raises(ValueError, match="estimates: got no looks"):
        ospa2(x[:0], mask[:0], x[:0], mask[:0], cutoff=1.0, order=1.0)
    with pytest.raises(ValueError, match="window: got 0"):
        ospa2_over_time(x, mask, x, mask, cutoff=1.0, order=1.0, window=0)
    with pytest.raises(TypeError, match="identity: got dtype"):
        trajectories(x, mask, x[..., 0], identities=2)
    with pytest.raises(TypeError, match="identity: got dtype uint32, want signed integers"):
        trajectories(x, mask, jnp.zeros((3, 2), jnp.uint32), identities=2)
    with pytest.raises(ValueError, match="identity: got shape"):
        trajectories(x, mask, jnp.zeros((3, 1), int), identities=2)
