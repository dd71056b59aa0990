"""The extractor against loops, sparse against dense, and the cheap ranking against the full one."""

import functools
import math

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from jaxtrack.hough import improved, neutrosophic
from jaxtrack.hough.grid import Grid, Sizes
from jaxtrack.hough.peaks import extract, extract_dense, smooth
from jaxtrack.hough.votes import Votes, accumulate, gaussian, hard
from jaxtrack.sensors import crossing_targets, observe
from tests.hough.cases import (
    ORIGIN,
    PEAKS,
    RHO_MAX,
    assert_same_lines,
    expected_lines,
    few,
    lines_of,
)
from tests.oracles import lines, peaks, votes

SMALL = Sizes(lines=4, candidates=10**6, rho=20, theta=24)
CELLS = votes.Grid(RHO_MAX, SMALL.rho, SMALL.theta)
GRID = Grid(ORIGIN, RHO_MAX)
SIZE = 12
FLOAT = jnp.dtype(np.float64)
EPS = (30.0, 0.1)
dense = settings(few, max_examples=6)


@st.composite
def random_votes(draw):
    """Votes in clusters, many on the seam, some outside, NaN behind the mask."""
    rng = np.random.default_rng(draw(st.integers(0, 2**32 - 1)))
    centre = rng.uniform((-1.1 * RHO_MAX, -0.1), (1.1 * RHO_MAX, 0.3), (3, 2))
    centre[2, 1] = rng.uniform(0.0, math.pi)
    at = centre[rng.integers(3, size=SIZE)] + rng.normal(size=(SIZE, 2)) * (40.0, 0.12)
    rho, theta = np.transpose([lines.wrap(*line) for line in at])
    weight = rng.uniform(0.1, 1.0, SIZE)
    missing = draw(st.lists(st.integers(0, SIZE - 1), max_size=SIZE))
    mask = ~np.isin(np.arange(SIZE), missing)
    cast = [(rho[n], theta[n], weight[n]) for n in np.flatnonzero(mask)]
    table = [jnp.asarray(np.where(mask, x, np.nan)) for x in (rho, theta, weight)]
    return Votes(*table, jnp.asarray(mask)), cast


@functools.cache
def sparse(kind):
    kernel = gaussian(*EPS) if kind == "spread" else hard(GRID, SMALL._replace(smooth=kind), FLOAT)
    return jax.jit(lambda query, cast, p: extract(query, cast, kernel, GRID, p, sizes=SMALL))


@pytest.mark.parametrize("kind", [0, 1, "spread"])
@few
@given(case=random_votes(), gate=st.sampled_from((0.0, 0.4)))
def test_lines_equal_the_oracle(kind, case, gate):
    table, cast = case
    extractor = PEAKS._replace(gate=gate)
    if kind == "spread":
        scale = lines.tolerance_scale(*EPS)
        read = lambda query: votes.gaussian_value(query, cast, scale)
        refine = lambda peak: peaks.refine_mean_shift(peak, cast, scale)
    else:
        read = lambda query: votes.smoothed_value(query, cast, CELLS, kind)
        refine = lambda peak: peaks.refine(peak, cast, CELLS, max(1, 3 * kind))
        if kind == 0:
            read = lambda query: votes.hard_value(query, cast, CELLS)
    queries = [vote[:2] for vote in cast]
    expected = expected_lines(queries, read, refine, extractor, ORIGIN, SMALL.lines)
    assert_same_lines(sparse(kind)(table, table, extractor), expected)


@functools.cache
def from_accumulator(smoothing):
    sizes = SMALL._replace(smooth=smoothing)

    def both(cast, extractor):
        table = accumulate(cast, GRID, sizes=sizes)
        smoothed = smooth(table, sizes=sizes) if smoothing else table
        return table, smoothed, extract_dense(table, GRID, extractor, sizes=sizes)

    return jax.jit(both)


@pytest.mark.parametrize("smoothing", [0, 1, 2])
@dense
@given(case=random_votes())
def test_dense_lines_equal_the_oracle_and_those_at_all_cells(smoothing, case):
    table, cast = case
    counts, smoothed, got = from_accumulator(smoothing)(table, PEAKS)
    np.testing.assert_allclose(counts, votes.dense(cast, CELLS), rtol=1e-10, atol=1e-13)
    centres = [cell[:2] for cell in peaks.cell_votes(counts, CELLS)]
    centred = [vote for vote in peaks.cell_votes(np.asarray(counts), CELLS) if vote[2] > 0.0]
    if smoothing:
        values = [votes.smoothed_value(centre, centred, CELLS, smoothing) for centre in centres]
        np.testing.assert_allclose(smoothed.ravel(), values, rtol=1e-10, atol=1e-13)
    # Values that are equal but for rounding are told apart by the order of the sums: read them
    # off the library's own table.
    valued = [(*centre, value) for centre, value in zip(centres, smoothed.ravel(), strict=True)]
    found = peaks.greedy(valued, *PEAKS[:2], SMALL.lines)
    refine = lambda peak: peaks.refine(peak, centred, CELLS, max(1, 3 * smoothing))
    expected = lines_of(found, refine, PEAKS, ORIGIN)
    assert_same_lines(got, expected)

    cells = [jnp.asarray(x) for x in np.transpose(peaks.cell_votes(np.asarray(counts), CELLS))]
    everywhere = Votes(*cells, jnp.ones(len(centres), bool))
    if smoothing == 0:
        assert_same_lines(sparse(0)(everywhere, everywhere, PEAKS), expected)


def test_lines_closer_than_the_separation_are_one():
    at = [(100.0, 1.0), (149.0, 1.0), (100.0, 1.19), (151.0, 1.0), (100.0, 1.21), (-100.0, 3.1)]
    rho, theta = np.transpose([*at, (110.0, 0.01)])
    weight = jnp.array([7.0, 6.0, 5.0, 4.0, 3.0, 2.0, 1.0])
    table = Votes(jnp.asarray(rho), jnp.asarray(theta), weight, jnp.ones(7, bool))
    kernel = gaussian(1e-3, 1e-6)
    got = extract(table, table, kernel, GRID, PEAKS, sizes=SMALL._replace(lines=7))
    assert got.votes[got.mask].round(9).tolist() == [7.0, 4.0, 3.0, 2.0]


def test_what_a_tail_alone_holds_up_is_no_line():
    at = Votes(jnp.array([0.0, 0.0]), jnp.array([1.0, 1.25]), jnp.ones(2), jnp.ones(2, bool))
    query = at._replace(rho_m=jnp.array([0.0, 380.0]))  # 12.7 ε away: 1e-35 votes
    kernel = gaussian(*EPS)
    got = jax.jit(lambda q: extract(q, at, kernel, GRID, PEAKS, sizes=SMALL))(query)
    assert got.mask.tolist() == [True, False, False, False]


def test_peaks_that_refinement_moves_together_are_one():
    # Both queries see the same cluster of votes halfway between them.
    votes_at = Votes(jnp.array([20.0]), jnp.array([1.0]), jnp.ones(1), jnp.ones(1, bool))
    query = Votes(*jnp.array([[-10.0, 50.0], [1.0, 1.0], [1.0, 1.0]]), jnp.ones(2, bool))
    got = extract(query, votes_at, gaussian(*EPS), GRID, PEAKS, sizes=SMALL)
    assert got.mask.sum() == 1
    np.testing.assert_allclose(lines.measured_from_zero(20.0, 1.0, ORIGIN), got.rho_m[0])


@pytest.mark.parametrize("order", [[0, 1, 2], [1, 0, 2], [2, 1, 0]])
def test_a_silenced_query_does_not_come_back_when_its_silencer_moves_away(order):
    rho, weight = jnp.array([0.0, 48.0, 62.0])[jnp.array(order)], jnp.array([0.6, 1.0, 0.99])
    table = Votes(rho, jnp.full(3, 1.0), weight[jnp.array(order)], jnp.ones(3, bool))
    got = extract(table, table, gaussian(15.0, 0.05), GRID, PEAKS, sizes=SMALL)
    assert got.mask.tolist() == [True, False, False, False]


METHODS = {
    "improved": (improved, improved.ImprovedParams(), {}, 0),
    "improved, smoothed": (improved, improved.ImprovedParams(), {}, 2),
} | {
    landing: (
        neutrosophic,
        neutrosophic.NeutrosophicParams(),
        {"rules": neutrosophic.Rules(landing=landing, scale=scale)},
        2,
    )
    for landing, scale in [
        ("own_cell", "tolerance"),
        ("own_and_kernel_cell", "tolerance"),
        ("spread", "tolerance"),
    ]
}


@pytest.mark.slow
@pytest.mark.parametrize(
    "name",
    [
        name if name in ("improved", "spread") else pytest.param(name, marks=pytest.mark.slow)
        for name in METHODS
    ],
)
def test_few_candidates_find_the_lines_of_all(name):
    method, params, static, smoothing = METHODS[name]
    scene = crossing_targets("IV", clutter_per_scan=20.0)
    origin = Grid((1750.0, 800.0), 2000.0)
    params = params._replace(grid=origin)
    some = Sizes(lines=4, pairs=384, predecessors=32, candidates=256, smooth=smoothing)
    every = some._replace(candidates=10**6)
    run = [
        jax.jit(lambda scan, s=s: method.estimate(scan, params, sizes=s, **static))
        for s in (some, every)
    ]
    for seed in range(4):
        scan = observe(jax.random.key(seed), scene.truth, scene.radar, detections=48)
        (got, info), (expected, _) = (one(scan) for one in run)
        assert int(info.votes.mask.sum()) > 2 * some.candidates
        assert not info.overflow
        wanted = np.transpose([np.asarray(x) for x in expected[:3]])
        assert_same_lines(got, [line for line, ok in zip(wanted, expected.mask, strict=True) if ok])
