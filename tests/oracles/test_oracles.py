"""The oracles against values worked out by hand."""

import math

import numpy as np
import pytest

from jaxtrack.types import Scan
from tests.oracles import (
    joint,
    lines,
    moments,
    neutrosophic,
    pairs,
    particle,
    peaks,
    rls,
    standard,
    votes,
)

ORIGIN = (0.0, 0.0)
SETTINGS = {
    "origin": ORIGIN,
    "eps_rho": 20.0,
    "eps_theta": 0.2,
    "p_false": 0.01,
    "lambda_k": 1.0,
    "p_gate": 0.99,
    "sigma": 10.0,
    "v_min": 50.0,
    "v_max": 150.0,
    "share_measurement": True,
    "scale": "tolerance",
    "first_interval_votes": False,
}


def scan_of(looks, **fields):
    """Return looks of one second, each a list of positions, padded with NaN."""
    size = max(len(look) for look in looks)
    position = np.full((len(looks), size, 2), np.nan)
    for k, look in enumerate(looks):
        for n, point in enumerate(look):
            position[k, n] = point
    fields = {
        "time_s": np.arange(float(len(looks))),
        "valid": np.ones(len(looks), bool),
        "position_m": position,
        "mask": np.isfinite(position[..., 0]),
    } | fields
    return Scan(**fields)  # pyright: ignore[reportArgumentType]


def crossing():
    """Return a target along the x axis, and one clutter point beside its first position."""
    return scan_of([[(0.0, 0.0), (0.0, 20.0)], [(100.0, 0.0)], [(200.0, 0.0)]])


def test_lines_by_hand():
    north = [lines.line_through((3, 0), (3, 5), ORIGIN), lines.line_through((3, 5), (3, 0), ORIGIN)]
    assert north == [(3.0, 0.0), (3.0, 0.0)]
    assert lines.line_through((-3, 1), (-3, 9), ORIGIN) == (-3.0, 0.0)
    assert lines.line_through((0, 4), (7, 4), ORIGIN) == pytest.approx((4.0, math.pi / 2))
    assert lines.line_through((0, -4), (7, -4), ORIGIN) == pytest.approx((-4.0, math.pi / 2))
    # y = x + 2: normal (−1, 1)/√2.
    rising = lines.line_through((0, 2), (1, 3), ORIGIN)
    assert rising == pytest.approx((math.sqrt(2.0), 3 * math.pi / 4))
    moved = lines.line_through((0, 2), (1, 3), (5.0, 1.0))
    assert lines.measured_from_zero(*moved, (5.0, 1.0)) == pytest.approx(rising[0])
    # A normal one rounding below π is the line of θ = 0.
    assert lines.line_through((-3, 0), (-3 + 1e-30, 1), ORIGIN) == pytest.approx((-3.0, 0.0))
    with pytest.raises(ValueError, match="no line"):
        lines.line_through((1, 1), (1, 1), ORIGIN)


def test_difference_is_continuous_across_the_seam():
    d_rho, d_theta = lines.difference(5.0, 0.01, -5.5, math.pi - 0.02)
    assert (d_rho, d_theta) == pytest.approx((-0.5, 0.03))
    d_rho, d_theta = lines.difference(-5.5, math.pi - 0.02, 5.0, 0.01)
    assert (d_rho, d_theta) == pytest.approx((-0.5, -0.03))
    assert lines.difference(1.0, math.pi / 2, 3.0, 0.0) == pytest.approx((-2.0, math.pi / 2))


def test_line_covariance_is_the_jacobians():
    rng = np.random.default_rng(0)
    step, sigma = 1e-5, 3.0
    for trial in range(50):
        points, origin = rng.uniform(-100, 100, (2, 2)), rng.uniform(-50, 50, 2)
        if trial == 0:  # a line whose θ = 0 is on the seam
            points[1, 0] = points[0, 0]
        at = lines.line_through(points[0], points[1], origin)
        columns = []
        for n in range(4):
            bump = np.zeros(4)
            bump[n] = step
            # at − moved, so that both ends are in the representation of `at`.
            ends = []
            for moved in (points + bump.reshape(2, 2), points - bump.reshape(2, 2)):
                ends.append(lines.difference(*at, *lines.line_through(moved[0], moved[1], origin)))
            columns.append((np.array(ends[1]) - np.array(ends[0])) / (2 * step))
        jacobian = np.array(columns).T
        expected = sigma**2 * jacobian @ jacobian.T
        got = lines.line_covariance(points[0], points[1], origin, sigma)
        np.testing.assert_allclose(got, expected, rtol=1e-6, atol=1e-6 * got[0, 0] ** 0.5)


def test_summed_covariance_does_not_know_where_the_seam_is():
    # The same two lines, turned by an angle that puts them on either side of θ = 0.
    p, q = np.array([[0.0, 3.0], [40.0, 2.0]]), np.array([[10.0, 4.0], [60.0, 9.0]])
    results = []
    for angle in (0.0, -math.pi / 2 - 0.07):
        turn = np.array([[math.cos(angle), -math.sin(angle)], [math.sin(angle), math.cos(angle)]])
        (a, b), (c, d) = p @ turn.T, q @ turn.T
        line_p, line_q = lines.line_through(a, b, ORIGIN), lines.line_through(c, d, ORIGIN)
        covariances = (
            lines.line_covariance(a, b, ORIGIN, 2.0),
            lines.line_covariance(c, d, ORIGIN, 2.0),
        )
        total = lines.summed_covariance(covariances[0], line_p[1], covariances[1], line_q[1])
        results.append(lines.gaussian(*lines.difference(*line_p, *line_q), total))
        twinned = lines.is_twinned(line_p[1], line_q[1])
        assert twinned == (angle != 0.0)
    assert results[0] == pytest.approx(results[1], rel=1e-9)
    assert 0.01 < results[0] < 0.99


def test_votes_by_hand():
    grid = votes.Grid(10.0, 20, 10)
    cast = [(0.5, 1.0, 2.0), (0.9, 1.1, 1.0), (1.2, 1.0, 4.0), (11.0, 1.0, 8.0)]
    assert votes.cell_of(0.5, 1.0, grid) == (10, 3)
    assert votes.cell_of(10.0, 1.0, grid) is None
    assert votes.hard_value((0.1, 0.95, 0.0), cast, grid) == 3.0
    assert votes.hard_value((10.5, 1.0, 0.0), cast, grid) == 0.0
    table = votes.dense(cast, grid)
    assert (table[3, 10], table[3, 11], table.sum()) == (3.0, 4.0, 7.0)
    g = [votes.cell_kernel(k, 1) for k in range(-4, 5)]
    assert sum(g) == pytest.approx(1.0)
    assert (g[0], g[8]) == (0.0, 0.0)
    assert g[5] / g[4] == pytest.approx(math.exp(-0.5))
    assert votes.smoothed_value((0.1, 0.95), cast, grid, 1) == pytest.approx(
        g[4] ** 2 * 3.0 + g[4] * g[5] * 4.0
    )
    # (−0.5, π − 0.1) is the cell (9, 9); seen from (10, 0) it is its twin (10, −1).
    seam = [(-0.5, math.pi - 0.1, 1.0)]
    assert votes.smoothed_value((0.5, 0.1), seam, grid, 1) == pytest.approx(g[4] * g[5])
    assert votes.gaussian_value((0.5, 0.1), seam, lines.tolerance_scale(1.0, 0.2)) == pytest.approx(
        math.exp(-0.5)
    )


@pytest.mark.parametrize("vote", [(0.4, 1.1, 1.0), (-0.4, 3.13, 1.0), (3.3, 0.02, 1.0)])
def test_soft_votes_sum_to_one_and_tend_to_hard_ones(vote):
    grid = votes.Grid(10.0, 20, 10)
    queries = peaks.cell_votes(np.zeros((10, 20)), grid)
    soft = [votes.soft_value(query, [vote], grid, 0.5, 0.1) for query in queries]
    assert sum(soft) == pytest.approx(1.0, abs=1e-9)
    assert max(soft) < 0.9
    sharp = [votes.soft_value(query, [vote], grid, 1e-4, 1e-4) for query in queries]
    hard = [votes.hard_value(query, [vote], grid) for query in queries]
    np.testing.assert_allclose(sharp, hard, atol=1e-9)


def test_standard_by_hand():
    scan = scan_of([[(2.0, 0.0)], [(2.0, 5.0)]], weight=np.array([[1.0], [0.5]]))
    # Three columns: θ = π/6, π/2, 5π/6. ρ = √3, 0, −√3 and √3 + 2.5, 5, −√3 + 2.5.
    table = standard.accumulator(scan, ORIGIN, 4.5, 9, 3)
    expected = np.zeros((3, 9))
    expected[0, 6] = expected[1, 4] = expected[2, 2] = 1.0  # ρ = 4.23 is cell 8; ρ = 5 is outside
    expected[0, 8] = expected[2, 5] = 0.5
    np.testing.assert_array_equal(table, expected)
    for j in range(3):
        for i in range(9):
            sharp = standard.soft_cell(scan, ORIGIN, 4.5, 9, 3, i, j, 1e-6, 1e-6)
            assert sharp == pytest.approx(expected[j, i], abs=1e-9)
    # At θ = π/2 the first detection has ρ = 0 and ρ' = −2.
    half = votes.interval_mass(-0.5, 0.5, 0.0, math.hypot(0.3, 2 * 0.2))
    far = votes.interval_mass(-0.5, 0.5, 5.0, math.hypot(0.3, 2 * 0.2))
    soft = standard.soft_cell(scan, ORIGIN, 4.5, 9, 3, 4, 1, 0.3, 0.2)
    assert soft == pytest.approx(half + 0.5 * far)


def test_pairs_keep_their_order_and_their_gates():
    scan = crossing()
    assert [p[:3] for p in pairs.candidate_pairs(scan)] == [(1, 0, 0), (1, 1, 0), (2, 0, 0)]
    assert [p[:3] for p in pairs.candidate_pairs(scan, 100.0, 100.0)] == [(1, 0, 0), (2, 0, 0)]
    assert pairs.candidate_pairs(scan._replace(valid=np.array([True, False, True]))) == []
    late = np.array([[0.0, 0.0], [-1.0, 0.0], [0.0, 0.0]])  # look 1 at the time of look 0
    assert [p[:3] for p in pairs.candidate_pairs(scan._replace(delay_s=late))] == [(2, 0, 0)]


def test_neutrosophic_by_hand():
    first, other, last = neutrosophic.memberships(crossing(), **SETTINGS)
    assert (first.vote, other.vote) == (0.0, 0.0)
    # The clutter's pair has the normal (20, 100)/√10400, the uncertain line from (0, 10) to
    # (100, 0) has (10, 100)/√10100; the target's has (0, 1) and ρ = 0.
    mu_other = math.exp(-0.5 * ((2000 / math.sqrt(10400) / 20) ** 2 + (math.atan(0.2) / 0.2) ** 2))
    mu = math.exp(-0.5 * ((1000 / math.sqrt(10100) / 20) ** 2 + (math.atan(0.1) / 0.2) ** 2))
    degrees = (last.T, last.I, last.F)
    assert degrees == pytest.approx((0.99, 0.99 * mu, 0.01))
    assert last.vote == pytest.approx(0.99 / (1.0 + 0.99 * mu))
    assert last.kernel.pair[:3] == first.pair[:3]

    # Outside the gates, whose radius is √(6 · 9.21) σ for r = 1, nothing is uncertain.
    for sigma, inside in ((20 / 7.5, False), (20 / 7.4, True)):
        last = neutrosophic.memberships(crossing(), **(SETTINGS | {"sigma": sigma}))[2]
        assert (last.I > 0.0) == inside
    # A light true kernel: the clutter's is o1, and the lighter weight counts for I.
    light = crossing()._replace(weight=np.array([[0.1, 1.0], [1.0, 0.0], [0.5, 0.0]]))
    last = neutrosophic.memberships(light, **SETTINGS)[2]
    assert last.kernel.pair[:3] == other.pair[:3]
    degrees = (last.T, last.I)
    assert degrees == pytest.approx((0.99 * mu_other, 0.099 * mu))
    best = max(degrees)
    assert last.vote == pytest.approx(0.5 * best / (last.T + last.I + 0.01))
    # F wins: no vote.
    assert neutrosophic.memberships(crossing(), **(SETTINGS | {"lambda_k": 100.0}))[2].vote == 0.0


def test_neutrosophic_landings_and_sharing():
    own = neutrosophic.votes(crossing(), **SETTINGS, landing="own_cell")
    both = neutrosophic.votes(crossing(), **SETTINGS, landing="own_and_kernel_cell")
    assert both == [*own, own[2]]  # the kernel has the target's own line
    started = SETTINGS | {"first_interval_votes": True}
    weights = [vote[2] for vote in neutrosophic.votes(crossing(), **started, landing="spread")]
    assert weights == pytest.approx([0.99, 0.99, own[2][2]])
    # Two parallel targets 10 m apart: without sharing each supports the other.
    looks = [[(100.0 * k, 0.0), (100.0 * k, 10.0)] for k in range(3)]
    parallel = SETTINGS | {"v_min": 99.9, "v_max": 100.1}
    shared = neutrosophic.memberships(scan_of(looks), **parallel)
    loose = neutrosophic.memberships(scan_of(looks), **(parallel | {"share_measurement": False}))
    assert [m.I for m in shared] == [0.0] * 4
    uncertain = loose[2].I
    assert uncertain == pytest.approx(0.99 * math.exp(-0.5 * (5.0 / 20.0) ** 2))


def test_peaks_by_hand():
    queries = [
        (0.0, 1.0, 3.0),
        (1.0, 1.05, 5.0),
        (5.0, 1.0, 3.0),
        (-1.2, 1.02, 0.0),
        (7.0, 2.0, 3.0),
    ]
    found = peaks.greedy(queries, 2.0, 0.1, 4)
    assert [peak.index for peak in found] == [1, 2, 4]
    assert [peak.index for peak in peaks.greedy(queries, 2.0, 0.1, 1)] == [1]
    seam = [(4.0, 0.01, 2.0), (-4.1, math.pi - 0.01, 1.0)]
    assert [peak.index for peak in peaks.greedy(seam, 0.2, 0.1, 4)] == [0]

    grid = votes.Grid(10.0, 20, 10)
    # Cells (14, 0), (5, 9) with twin (14, −1), and (17, 0), which is too far.
    cast = [(4.3, 0.02, 1.0), (-4.7, math.pi - 0.1, 3.0), (7.5, 0.02, 5.0)]
    rho, theta = peaks.refine((4.5, 0.1), cast, grid, 1)
    assert (rho, theta) == pytest.approx((-4.6, math.pi - 0.07))
    scale = lines.tolerance_scale(1.0, 0.1)
    near = math.exp(-0.5 * (0.16 + 1.44))  # Δ = (−0.4, 0.12)
    rho, theta = peaks.refine_mean_shift((4.3, 0.02), cast[:2], scale)
    share = 3 * near / (1 + 3 * near)
    assert (rho, theta) == pytest.approx((-4.3 - 0.4 * share, math.pi + 0.02 - 0.12 * share))

    table = votes.dense(cast, grid)
    assert [peak.votes for peak in peaks.greedy_dense(table, grid, 1.5, 0.5, 5)] == [5.0, 3.0]
    smooth = peaks.greedy_dense(table, grid, 1.5, 0.5, 1, smoothing=1)[0]
    centre = (smooth.rho, smooth.theta)
    assert smooth.votes == pytest.approx(votes.smoothed_value(centre, cast, grid, 1))
    near_line = peaks.members(0.0, math.pi / 2, crossing(), 5.0)
    assert near_line.tolist() == [[True, False], [True, False], [True, False]]


def test_joint_by_hand():
    scan = crossing()
    sensor = {"p_detect": 0.9, "clutter_density": 1e-5, "sigma": 10.0}
    state = np.array([0.0, 0.0, 100.0, 0.0])
    peak = 0.9 / 1e-5 / (2 * math.pi * 100.0)
    expected = math.log(0.1 + peak * (1.0 + math.exp(-2.0)))
    assert joint.log_likelihood_ratio(state, scan, 0, **sensor) == pytest.approx(expected)
    alone = math.log(0.1 + peak)
    assert joint.score(state, 0.0, scan, **sensor) == pytest.approx(expected + 2 * alone)
    lost = scan._replace(valid=np.array([True, False, True]))
    assert joint.score(state, 0.0, lost, **sensor) == pytest.approx(expected + alone)
    empty = scan._replace(mask=np.zeros((3, 2), bool))
    assert joint.score(state, 0.0, empty, **sensor) == pytest.approx(3 * math.log(0.1))
    # A detection half a second late is compared with the position then; R is the detection's.
    late = scan._replace(
        delay_s=np.array([[0.0, 0.0], [0.5, 0.0], [0.0, 0.0]]),
        covariance_m2=np.tile(np.array([[400.0, 30.0], [30.0, 100.0]]), (3, 2, 1, 1)),
    )
    root = math.sqrt(40000.0 - 900.0)
    miss = math.exp(-0.5 * 50.0**2 * 100.0 / root**2)
    expected = math.log(0.1 + 0.9 / 1e-5 / (2 * math.pi * root) * miss)
    value = joint.log_likelihood_ratio([100.0, 0.0, 100.0, 0.0], late, 1, **sensor)
    assert value == pytest.approx(expected)

    best = joint.best_pair_hypothesis(scan, **sensor, v_min=50.0, v_max=150.0, min_gap=2)
    assert best is not None
    assert best[3:] == (0, 0, 2, 0)
    np.testing.assert_allclose(best.state, state)
    assert joint.best_pair_hypothesis(scan, **sensor, v_min=1.0, v_max=2.0, min_gap=1) is None


def test_batch_least_squares_is_the_recursions_end():
    rng = np.random.default_rng(1)
    time_s, mask = np.arange(8.0), np.array([1, 1, 0, 1, 1, 0, 1, 1], bool)
    z = np.where(mask[:, None], np.outer(time_s, [3.0, -2.0]) + rng.normal(size=(8, 2)), np.nan)
    forgetting, delta, t_ref = 0.9, 50.0, 2.0
    b, p = np.zeros((2, 2)), delta * np.eye(2)
    for k in np.flatnonzero(mask):
        phi = np.array([1.0, time_s[k] - t_ref])
        gain = p @ phi / (forgetting + phi @ p @ phi)
        b = b + np.outer(gain, z[k] - b.T @ phi)
        p = (p - np.outer(gain, phi) @ p) / forgetting
    got_b, got_p = rls.batch(time_s, z, mask, t_ref, forgetting, delta)
    np.testing.assert_allclose(got_b, b, rtol=1e-9)
    np.testing.assert_allclose(got_p, p, rtol=1e-9)
    start = np.array([[1.0, 2.0], [3.0, 4.0]])
    none = rls.batch(time_s, z, np.zeros(8, bool), t_ref, forgetting, delta, start)
    np.testing.assert_allclose(none[0], start)


@pytest.mark.parametrize("scale", ["tolerance", "covariance"])
def test_turning_the_scene_about_the_origin_changes_no_membership(scale):
    rng = np.random.default_rng(2)
    looks = [
        [(90.0 * k, 60.0 * k + 5.0 * n) + rng.normal(size=2) * 8.0 for n in range(3)]
        for k in range(4)
    ]
    settings = SETTINGS | {"eps_theta": 0.1, "p_gate": 0.999, "scale": scale}
    reference, twinned = None, 0
    for angle in np.arange(12) * 0.27:
        turn = np.array([[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]])
        found = neutrosophic.memberships(scan_of([look @ turn.T for look in looks]), **settings)
        degrees = [(m.T, m.I, m.vote) for m in found]
        reference = reference or degrees
        np.testing.assert_allclose(degrees, reference, rtol=1e-8, atol=1e-12)
        twinned += sum(m.kernel is not None and abs(m.theta - m.kernel.theta) > 2.0 for m in found)
    assert twinned > 0
    assert sum(degree[1] > 0.0 for degree in reference or []) > 5


def test_resampling_by_hand():
    weights = [2.0, 0.0, 1.0, 1.0]  # running sums ½, ½, ¾, 1
    assert particle.systematic(weights, 0.5) == [0, 0, 2, 3]
    assert particle.stratified(weights, [0.9, 0.9, 0.9, 0.9]) == [0, 0, 2, 3]
    assert particle.multinomial(weights, [0.0, 0.5, 0.74, 0.99]) == [0, 2, 2, 3]
    assert particle.residual([3.0, 0.0, 2.0, 1.0], [0, 0, 0, 0.8]) == [0, 0, 2, 3]
    assert particle.mixed(weights, 0.5) == [0.375, 0.125, 0.25, 0.25]
    np.testing.assert_allclose(particle.monotone(np.array([1.0, 0.0]), [0.25, 0.75]), [0.0, 0.5])
    assert particle.effective_size([2.0, 2.0, 0.0]) == 2.0


def test_a_particle_filter_by_hand():
    looks = [{"valid": True, "g": (0.2, 0.6)}, {"valid": False}, {"valid": True, "g": (0.0, 0.0)}]
    done = particle.run(
        [[0.0], [1.0]],
        looks,
        lambda x, i, look: x + 1,
        lambda x, look: look["g"][int(x[0]) % 2 == 0],
        lambda weights: [1, 1],
        0.0,
    )
    np.testing.assert_allclose([one["mean"][0] for one in done], [1.75, 1.75, 2.75])
    np.testing.assert_allclose(done[0]["log_likelihood"], math.log(0.4))
    assert [one["vanished"] for one in done] == [False, False, True]
    np.testing.assert_allclose(done[2]["weights"], [0.25, 0.75])


def test_moments_by_hand():
    for rho in (0.0, 0.25, 0.8, 1.0):
        assert moments.radial(3, 1, rho) == pytest.approx(3 * rho**3 - 2 * rho)
        assert moments.radial(4, -2, rho) == pytest.approx(4 * rho**4 - 3 * rho**2)
        assert moments.radial(8, 8, rho) == pytest.approx(rho**8)
    # At (0, 1) of a radius of 2, and none at (3, 0): R_22 = 1/4, exp(−2jπ/2) = −1.
    points = [(0.0, 1.0), (3.0, 0.0), (math.nan, 0.0)]
    assert moments.zernike(points, [2.0, 1.0, 1.0], 2, 2, 2.0) == pytest.approx(-0.75 / math.pi)
    assert moments.zernike(points[1:], [1.0, 1.0], 2, 2, 2.0) == 0.0
    assert [moments.fade(rho, 0.5) for rho in (0.4, 0.5, 1.0, 1.1)] == [1.0, 1.0, 0.0, 0.0]
    assert moments.fade(math.sqrt(1 - 0.375), 0.5) == pytest.approx(0.5)

    # Two points of weight 1 at ±1: μ20 = 2, η20 = 1/2, nothing odd.
    assert moments.hu([(1.0, 0.0), (-1.0, 0.0)], [1.0, 1.0]) == pytest.approx([0.5, 0.25] + [0] * 5)
    # Weights 2 at 0 and 1 at 3: about x̄ = 1, μ20 = 6 and μ30 = 6, over 3² and 3^2.5.
    e, a = 6 / 9, 6 / 3**2.5
    got = moments.hu([(0.0, 0.0), (3.0, 0.0)], [2.0, 1.0])
    assert got == pytest.approx([e, e**2, a**2, a**2, a**4, e * a**2, 0.0])
    # Three corners of a triangle: x̄ = (1, 1), μ20 = μ02 = 6, μ11 = −3, μ30 = 6, μ21 = −3.
    got = moments.hu([(0.0, 0.0), (3.0, 0.0), (0.0, 3.0)], [1.0, 1.0, 1.0])
    third, q = 3**2.5, 9.0
    a, c, twist = (6 - 3) / third, (6 + 9) / third, -3 / q
    expected = [12 / q, 4 * twist**2, 2 * c**2, 2 * a**2]
    assert got[:4] == pytest.approx(expected)
    # b = a and d = −c: I5 = c a (−2a²) − c a (2a²), I6 = 4η11 a², I7 = −c a (−2a²) − c a (2a²).
    assert got[4:] == pytest.approx([-4 * c * a**3, 4 * twist * a**2, 0.0], abs=1e-12)
