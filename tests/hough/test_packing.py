"""Detections in fewer places: the same detections, in order, and told where they do not fit."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from jaxtrack.hough import pack_beams, pack_detections
from jaxtrack.sensors import motion_elements_scene, observe_beams, scan_of_beams
from jaxtrack.types import Scan


def random_scans(seed, looks=4, places=9):
    """Return looks with a lost one and a detection of weight 0; NaN where nothing counts."""
    rng = np.random.default_rng(seed)
    valid, mask = np.arange(looks) != 1, rng.random((looks, places)) < 0.4
    weight = rng.uniform(0.2, 1.0, mask.shape)
    weight[0, np.flatnonzero(mask[0])[:1]] = 0.0
    counts = mask & valid[:, None]
    hide = lambda x: jnp.where(counts.reshape(counts.shape + (1,) * (x.ndim - 2)), x, jnp.nan)
    position = hide(rng.normal(size=(looks, places, 2)))
    delay = hide(rng.normal(size=mask.shape))
    return Scan(np.arange(4.0), valid, position, mask, weight=hide(weight), delay_s=delay)


def kept(scans, k):
    """Return what counts in a look, in order: position, weight and delay."""
    counts = np.asarray(scans.mask[k] & scans.valid[k]) & (np.asarray(scans.weight[k]) > 0)
    columns = scans.position_m[k], scans.weight[k][:, None], scans.delay_s[k][:, None]
    return np.concatenate(columns, axis=-1)[counts]


def test_packing_keeps_what_counts_in_order_and_says_what_does_not_fit():
    crowded = set()
    for seed in range(8):
        scans = random_scans(seed)
        for places in (3, 8):
            packed, overflow = jax.jit(pack_detections, static_argnums=1)(scans, places)
            assert packed.mask.shape == (4, places)
            for k in range(4):
                np.testing.assert_array_equal(kept(packed, k), kept(scans, k)[:places])
            most = max(len(kept(scans, k)) for k in range(4))
            assert bool(overflow) == (most > places)
            crowded.add(bool(overflow))
    assert crowded == {False, True}


def test_places_enough_change_nothing():
    scans = random_scans(0)
    for places in (None, 9, 20):
        packed, overflow = pack_detections(scans, places)
        assert packed is scans
        assert not overflow


@pytest.mark.slow
def test_beams_become_the_positions_of_what_they_report():
    scene = motion_elements_scene()
    beams = observe_beams(jax.random.key(1), *scene, false_alarms="per_scan")
    packed, overflow = jax.jit(pack_beams, static_argnums=2)(beams, scene.sonar, 5)
    positions = jax.vmap(scan_of_beams, (0, None))(beams, scene.sonar)
    assert not overflow
    assert packed.covariance_m2 is None
    assert packed.mask.sum() == beams.mask.sum() > 20
    for k in range(20):
        expected = positions.position_m[k][beams.mask[k]]
        np.testing.assert_allclose(packed.position_m[k][packed.mask[k]], expected, rtol=1e-12)
    assert pack_beams(beams, scene.sonar, 1)[1]
