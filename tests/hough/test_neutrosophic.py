"""The neutrosophic transform against loops over pairs, kernels and queries."""

import functools
import itertools

import jax
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from jaxtrack.hough import neutrosophic
from jaxtrack.hough.grid import Grid
from jaxtrack.hough.neutrosophic import NeutrosophicParams, Rules
from jaxtrack.hough.pairs import candidate_pairs
from tests.hough.cases import (
    CELLS,
    GRID,
    ORIGIN,
    PEAKS,
    SIZES,
    SPEED,
    assert_same_info,
    assert_same_lines,
    expected_lines,
    few,
    looks,
    random_looks,
)
from tests.oracles import lines, peaks, votes
from tests.oracles import neutrosophic as oracle

PARAMS = NeutrosophicParams(GRID, PEAKS, SPEED, eps_rho_m=20.0, eps_theta_rad=0.15, sigma_m=10.0)
SCALES = ("tolerance", "covariance")
# Every landing, scale and option, raw and smoothed, without all their combinations.
READINGS = [
    (Rules("own_cell", "tolerance", True, True), 0),
    (Rules("own_and_kernel_cell", "covariance", True, True), 2),
    (Rules("own_and_kernel_cell", "tolerance", True, False), 0),
    (Rules("spread", "covariance", False, True), 0),
]
# Each rule occurs above; how they go together otherwise is for the slow run.
MORE_READINGS = [
    (Rules("own_cell", "tolerance", False, True), 1),
    (Rules("own_cell", "covariance", True, False), 1),
    (Rules("own_and_kernel_cell", "covariance", False, True), 0),
    (Rules("spread", "tolerance", False, False), 0),
    (Rules("spread", "covariance", True, True), 0),
]
ALL_READINGS = [*READINGS, *(pytest.param(*one, marks=pytest.mark.slow) for one in MORE_READINGS)]
RAW_READINGS = [
    *(rules for rules, smooth in READINGS if not smooth),
    *(pytest.param(r, marks=pytest.mark.slow) for r, smooth in MORE_READINGS if not smooth),
]
fewer = settings(few, max_examples=8)
OPTIONS = list(itertools.product((True, False), (True, False)))


def oracle_settings(params, rules):
    return {
        "origin": params.grid.origin_m,
        "eps_rho": params.eps_rho_m,
        "eps_theta": params.eps_theta_rad,
        "p_false": params.p_false,
        "lambda_k": params.adjustment,
        "p_gate": params.p_gate,
        "sigma": params.sigma_m,
        "v_min": params.speed.v_min_m_s,
        "v_max": params.speed.v_max_m_s,
        "share_measurement": rules.share_measurement,
        "scale": rules.scale,
        "first_interval_votes": rules.first_interval_votes,
    }


@st.composite
def parameters(draw):
    rng = np.random.default_rng(draw(st.integers(0, 2**32 - 1)))
    return PARAMS._replace(
        eps_rho_m=rng.uniform(10.0, 40.0),
        eps_theta_rad=rng.uniform(0.05, 0.3),
        p_false=rng.uniform(0.005, 0.1),
        adjustment=rng.uniform(0.5, 4.0),
        p_gate=rng.uniform(0.8, 0.999),
        sigma_m=rng.uniform(5.0, 15.0),
    )


@functools.cache
def jitted_memberships(rules, sizes=SIZES):
    def run(scan, params):
        origin = jax.numpy.stack(params.grid.origin_m)
        pairs = candidate_pairs(scan, origin, params.speed, pairs=sizes.pairs)
        return pairs.mask, neutrosophic.memberships(pairs, params, sizes=sizes, rules=rules)

    return jax.jit(run)


@functools.cache
def jitted(rules, smooth=0):
    sizes = SIZES._replace(smooth=smooth)
    return jax.jit(
        lambda scan, params: neutrosophic.estimate(scan, params, sizes=sizes, rules=rules)
    )


@functools.cache
def jitted_soft(rules):
    return jax.jit(
        lambda scan, params, temperature: neutrosophic.soft_estimate(
            scan, params, temperature, sizes=SIZES, rules=rules
        )
    )


def check_memberships(scan, params, rules):
    mask, got = jitted_memberships(rules)(scan, params)
    expected = oracle.memberships(scan, **oracle_settings(params, rules))
    flat = [np.asarray(x)[np.asarray(mask)] for x in got[:-1]]
    assert len(expected) == len(flat[0])
    for n, member in enumerate(expected):
        wanted = (member.T, member.I, member.F, member.vote)
        np.testing.assert_allclose([x[n] for x in flat[:4]], wanted, rtol=1e-10, atol=1e-13)
        if member.kernel is not None and member.T > 0.0:
            kernel = (flat[4][n], flat[5][n])
            delta = lines.difference(*kernel, member.kernel.rho, member.kernel.theta)
            np.testing.assert_allclose(delta, 0.0, atol=1e-9)
    np.testing.assert_array_equal(np.asarray(got.vote)[~np.asarray(mask)], 0.0)
    assert not got.overflow
    return expected


@pytest.mark.parametrize("scale", SCALES)
@pytest.mark.parametrize(("share", "opening"), OPTIONS)
@few
@given(scan=looks(shapes=((4, 5),)), params=parameters())
def test_memberships_equal_the_oracle(scale, share, opening, scan, params):
    rules = Rules(scale=scale, share_measurement=share, first_interval_votes=opening)
    check_memberships(scan, params, rules)


@pytest.mark.parametrize("scale", SCALES)
def test_random_looks_meet_every_case(scale):
    rules = Rules(scale=scale)
    found = []
    for seed in range(20):
        scan = random_looks(np.random.default_rng(seed), 4, 5)
        found += [m for m in check_memberships(scan, PARAMS, rules) if m.pair.k > 1]
    assert sum(m.T > 0.0 for m in found) > 30
    assert sum(m.I > 0.0 for m in found) > 10
    assert sum(m.I > m.T for m in found) > 2
    assert sum(m.T == 0.0 for m in found) > 30
    twins = [m for m in found if m.kernel and abs(m.theta - m.kernel.theta) > 2.0]
    assert len(twins) > 3


@pytest.mark.parametrize(("rules", "smooth"), ALL_READINGS, ids=str)
@fewer
@given(scan=looks(shapes=((4, 5),)), params=parameters(), gate=st.sampled_from((0.0, 0.5)))
def test_lines_equal_the_oracle(rules, smooth, scan, params, gate):
    check_lines(scan, params._replace(peaks=PEAKS._replace(gate=gate)), rules, smooth)


@few
@given(scan=looks(), params=parameters())
def test_default_rules_equal_the_oracle_at_every_shape(scan, params):
    check_lines(scan, params, Rules(), 0)


def check_lines(scan, params, rules, smooth):
    got, info = jitted(rules, smooth)(scan, params)
    options = oracle_settings(params, rules)
    members = oracle.memberships(scan, **options)
    cast = oracle.votes(scan, **options, landing=rules.landing)
    if rules.landing == "spread":
        eps = params.eps_rho_m, params.eps_theta_rad
        scale = oracle.spread_scales(members, *eps, rules.scale).reshape(-1, 2, 2)
        read = lambda query: votes.gaussian_value(query, cast, scale)
        refine = lambda peak: peaks.refine_mean_shift(peak, cast, scale)
    else:
        read = lambda query: votes.smoothed_value(query, cast, CELLS, smooth)
        if not smooth:
            read = lambda query: votes.hard_value(query, cast, CELLS)
        refine = lambda peak: peaks.refine(peak, cast, CELLS, max(1, 3 * smooth))
    queries = [(member.rho, member.theta) for member in members]
    expected = expected_lines(queries, read, refine, params.peaks, ORIGIN, SIZES.lines)
    assert_same_lines(got, expected)
    assert_same_info(info, got, scan, params.peaks)
    there = np.asarray(info.votes.mask & (info.votes.weight > 0.0))
    wanted = [vote[2] for vote in cast if vote[2] > 0.0]
    np.testing.assert_allclose(info.votes.weight[there], wanted, rtol=1e-10)


@pytest.mark.parametrize("rules", RAW_READINGS, ids=str)
def test_soft_lines_tend_to_the_hard_ones(rules):
    params = PARAMS._replace(grid=Grid(ORIGIN, 700.0))
    for seed in range(6):
        scan = random_looks(np.random.default_rng(seed), 4, 5)
        expected, _ = jitted(rules)(scan, params)
        wide, _ = jitted_soft(rules)(scan, params, 0.3)
        assert np.abs(wide.votes - expected.votes).max() > 1e-3
        got, _ = jitted_soft(rules)(scan, params, 1e-8)
        wanted = np.transpose([np.asarray(x) for x in expected[:3]])
        assert_same_lines(got, wanted[np.asarray(expected.mask)], rtol=1e-6, rho_atol=1e-5)


def test_too_many_kernels_of_a_detection_are_reported():
    scan = random_looks(np.random.default_rng(0), 4, 5)
    sizes = SIZES._replace(predecessors=1)
    for rules, overflow in ((Rules(), True), (Rules(share_measurement=False), False)):
        assert jitted_memberships(rules, sizes)(scan, PARAMS)[1].overflow == overflow


def test_unknown_rules_are_refused():
    scan = random_looks(np.random.default_rng(0), 4, 5)
    with pytest.raises(ValueError, match=r"rules\.landing: got 'cell'"):
        neutrosophic.estimate(scan, PARAMS, sizes=SIZES, rules=Rules(landing="cell"))
    with pytest.raises(ValueError, match=r"rules\.scale: got 'unit'"):
        neutrosophic.estimate(scan, PARAMS, sizes=SIZES, rules=Rules(scale="unit"))
