"""From a sweep to places: the assembly against the loops, and on simulated runs."""

import math

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from jaxtrack.sensors import IMAGENEX_881L, DraggedBucket, PingSizes, ScanningPreset, dragged_bucket
from jaxtrack.tracking import PingDetection, detect_in_pings
from tests.oracles import pings as oracle

SONAR = IMAGENEX_881L.sonar
PRESET = ScanningPreset(SONAR, PingSizes(bins=400, facets=8, rays=4))
FRAMES = 8
detect = jax.jit(jax.vmap(lambda pings, params: detect_in_pings(pings, SONAR, params), (0, None)))


@pytest.fixture(scope="module")
def run():
    draw = lambda key: dragged_bucket(
        key,
        "hovering",
        "two_objects",
        frames=FRAMES,
        preset=PRESET,
        scene=DraggedBucket(0.25, clutter_m=3.0),
    )
    return jax.tree.map(np.asarray, jax.jit(draw)(jax.random.key(3)))


def sweep(run, t):
    pings = jax.tree.map(lambda x: x[t], run.pings)
    pose = pings.pose
    return [
        (pings.time_s[q], pings.bearing_rad[q], pose.position_m[q], pose.heading_rad[q], row)
        for q, row in enumerate(pings.intensity)
    ]


def test_places_are_those_of_the_loops(run):
    params = PingDetection()
    scans, info = detect(run.pings, params)
    assert not info.overflow.any()
    for t in range(FRAMES):
        mount = SONAR.range_max_m, SONAR.mount_m, SONAR.mount_rad
        cells, _ = oracle.cloud(sweep(run, t), params.threshold, *mount, 512)
        points, weights = [at for at, *_ in cells], [w for _, _, w, _ in cells]
        stand = run.pings.pose.position_m[t].mean(axis=0)
        gaps = [max(0.6, 1.5 * SONAR.step_rad * math.dist(at, stand)) for at in points]
        expected = [
            (centre, mass, members)
            for members, mass, centre in oracle.linked(points, weights, gaps, 3)
            if max(np.linalg.norm(np.array(points)[members] - centre, axis=1)) <= params.reach_m
        ]
        live = np.asarray(scans.mask[t])
        assert live.sum() == len(expected)
        np.testing.assert_allclose(scans.position_m[t][live], [c for c, *_ in expected], atol=1e-9)
        np.testing.assert_allclose(scans.intensity[t][live], [m for _, m, _ in expected], atol=1e-9)
        delays = [
            sum(weights[n] * (cells[n][3] - run.pings.time_s[t, 0]) for n in members) / mass
            for _, mass, members in expected
        ]
        np.testing.assert_allclose(scans.delay_s[t][live], delays, atol=1e-9)
        assert scans.time_s[t] == run.pings.time_s[t, 0]


def test_target_boat_and_objects_are_found_when_they_are_passed_and_the_dike_is_none(run):
    scans, info = detect(run.pings, PingDetection())
    for t in range(FRAMES):
        found = np.asarray(scans.position_m[t])[np.asarray(scans.mask[t])]
        gap = np.linalg.norm(found - run.truth.state[t, 0, :2], axis=1)
        assert gap.min() < 0.45
        delay = np.asarray(scans.delay_s[t])[np.asarray(scans.mask[t])][gap.argmin()]
        assert abs(scans.time_s[t] + delay - run.crossing_s[t, 0]) < 0.2
        assert (found[:, 1] > -37.0).all()
        assert 3 <= len(found) <= 6
    clusters = info.clusters
    dike = np.asarray(clusters.centre)[..., 1] < -37.0
    assert (dike & np.asarray(clusters.mask)).any(axis=1).all()
    everything = detect(run.pings, PingDetection(reach_m=100.0))[0]
    assert (np.asarray(everything.position_m)[..., 1] < -37.0).any(axis=1).all()


def test_no_pings_no_echoes_and_too_many(run):
    none = run.pings._replace(mask=np.zeros_like(run.pings.mask))
    silent = run.pings._replace(intensity=0 * run.pings.intensity)
    broken = run.pings._replace(intensity=np.full_like(run.pings.intensity, np.nan))
    for pings, valid in ((none, False), (silent, True), (broken, True)):
        scans, info = detect(pings, PingDetection())
        assert not scans.mask.any()
        assert (np.asarray(scans.valid) == valid).all()
        assert all(np.isfinite(np.asarray(x)).all() for x in jax.tree.leaves((scans, info)))
    everywhere = detect(run.pings, PingDetection(threshold=0.1))[1]
    assert everywhere.overflow.all()
    few = jax.jit(lambda pings: detect_in_pings(pings, SONAR, clusters=2))
    scan, info = few(jax.tree.map(lambda x: x[0], run.pings))
    assert (scan.mask.shape, bool(info.overflow)) == ((2,), True)


@pytest.mark.slow
def test_float32_one_trace_and_wrong_arguments(run):
    traces = []

    @jax.jit
    def one(pings, params):
        traces.append(1)
        return detect_in_pings(pings, SONAR, params)[0]

    first = jax.tree.map(lambda x: jnp.asarray(x[0]), run.pings)
    wide = one(first, PingDetection())
    one(first, PingDetection(5.0, 0.7, 2.0, 4, 1.0))
    assert len(traces) == 1
    small = jax.tree.map(lambda x: x.astype(jnp.float32) if x.dtype == float else x, first)
    got = one(small, PingDetection())
    assert got.position_m.dtype == jnp.float32
    np.testing.assert_allclose(got.position_m, wide.position_m, atol=1e-4)
    for params, message in (
        (PingDetection(threshold=-1.0), "threshold: got -1.0"),
        (PingDetection(gap_m=0.0), "params.gap_m: got 0.0"),
        (PingDetection(reach_m=0.0), "params.reach_m: got 0.0"),
    ):
        with pytest.raises(ValueError, match=message):
            detect_in_pings(first, SONAR, params)
