"""The modified and the improved transform against the oracles' pipeline."""

import functools

import jax
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from jaxtrack.hough import improved, modified
from jaxtrack.hough.grid import Grid
from tests.hough.cases import (
    CELLS,
    GRID,
    ORIGIN,
    PEAKS,
    SHAPES,
    SIZES,
    SPEED,
    assert_same_info,
    assert_same_lines,
    expected_lines,
    few,
    looks,
    random_looks,
)
from tests.oracles import lines, pairs, peaks, votes

METHODS = {
    "modified": (modified, modified.ModifiedParams(GRID, PEAKS), ()),
    "improved": (improved, improved.ImprovedParams(GRID, PEAKS, SPEED), SPEED),
}


@functools.cache
def jitted(name, smooth):
    sizes = SIZES._replace(smooth=smooth)
    return jax.jit(lambda scan, params: METHODS[name][0].estimate(scan, params, sizes=sizes))


@functools.cache
def jitted_soft(name):
    return jax.jit(
        lambda scan, params, *eps: METHODS[name][0].soft_estimate(scan, params, *eps, sizes=SIZES)
    )


@pytest.mark.parametrize(
    ("name", "smooth"),
    [
        ("modified", 0),
        ("improved", 1),
        pytest.param("modified", 1, marks=pytest.mark.slow),
        pytest.param("improved", 0, marks=pytest.mark.slow),
    ],
)
@few
@given(scan=looks(shapes=SHAPES[:2]), gate=st.sampled_from((0.0, 1.0)))
def test_lines_equal_the_oracle(name, smooth, scan, gate):
    _, params, gates = METHODS[name]
    extractor = PEAKS._replace(gate=gate / 5 if smooth else gate)
    got, info = jitted(name, smooth)(scan, params._replace(peaks=extractor))
    cast = [
        (*lines.line_through(pair.first, pair.second, ORIGIN), pair.weight)
        for pair in pairs.candidate_pairs(scan, *gates)
    ]
    if smooth:
        read = lambda query: votes.smoothed_value(query, cast, CELLS, smooth)
    else:
        read = lambda query: votes.hard_value(query, cast, CELLS)
    refine = lambda peak: peaks.refine(peak, cast, CELLS, max(1, 3 * smooth))
    queries = [vote[:2] for vote in cast]
    assert_same_lines(got, expected_lines(queries, read, refine, extractor, ORIGIN, SIZES.lines))
    assert_same_info(info, got, scan, extractor)
    there = np.asarray(info.votes.mask)
    np.testing.assert_allclose(
        np.transpose([x[there] for x in info.votes[:3]]),
        np.reshape(cast, (-1, 3)),
        rtol=1e-10,
        atol=1e-10,
    )


@pytest.mark.parametrize("name", METHODS)
def test_soft_lines_tend_to_the_hard_ones(name):
    # All lines are inside: votes beyond the edge would still pull a peak at the edge.
    params = METHODS[name][1]._replace(grid=Grid(ORIGIN, 700.0))
    found = 0
    for seed in range(8):
        scan = random_looks(np.random.default_rng(seed), 4, 5)
        expected, _ = jitted(name, 0)(scan, params)
        wide, _ = jitted_soft(name)(scan, params, 20.0, 0.05)
        assert np.abs(wide.votes - expected.votes).max() > 0.1
        got, _ = jitted_soft(name)(scan, params, 1e-8, 1e-11)
        wanted = np.transpose([np.asarray(x) for x in expected[:3]])
        assert_same_lines(got, wanted[np.asarray(expected.mask)], rtol=1e-9, rho_atol=1e-6)
        found += int(expected.mask.sum())
    assert found > 16
