"""Random looks for the tests of the Hough methods, and the oracles' way from votes to lines."""

import math

import numpy as np
from hypothesis import settings
from hypothesis import strategies as st

from jaxtrack.hough.grid import Grid, Sizes
from jaxtrack.hough.pairs import SpeedGate
from jaxtrack.hough.peaks import Peaks
from jaxtrack.types import Scan
from tests.oracles import lines, peaks, votes

SHAPES = ((4, 5), (3, 3), (5, 6))  # K looks of N detections
few = settings(max_examples=15, deadline=None, derandomize=True, database=None)

# Some pairs' lines are beyond ρ_max, so that votes are dropped.
ORIGIN, RHO_MAX = (430.0, 310.0), 420.0
GRID = Grid(ORIGIN, RHO_MAX)
SPEED = SpeedGate(80.0, 420.0)
PEAKS = Peaks(50.0, 0.2, 0.0, 30.0)
SIZES = Sizes(lines=4, pairs=36, predecessors=6, candidates=1024, rho=40, theta=60)
CELLS = votes.Grid(RHO_MAX, SIZES.rho, SIZES.theta)


def random_looks(rng, looks, detections, *, sigma=8.0):
    """Return looks about a second apart at straight targets, two of them side by side, in clutter.

    All positions are continuous: nothing lies on the edge of a cell, a box or a gate.
    """
    time_s = np.cumsum(rng.uniform(0.8, 1.2, looks))
    delay_s = rng.uniform(-0.2, 0.2, (looks, detections))
    position = rng.uniform((0.0, 0.0), (1000.0, 800.0), (looks, detections, 2))
    heading = rng.uniform(0.0, 2 * math.pi)
    along = np.array([math.cos(heading), math.sin(heading)])
    beside = rng.uniform(10.0, 30.0) * np.array([-along[1], along[0]])
    middle = rng.uniform((300.0, 200.0), (700.0, 600.0))
    for target in range(min(detections - 1, 3)):
        start, speed = middle + (target == 1) * beside, rng.uniform(120.0, 250.0)
        if target == 2:  # another target, on a line almost along an axis: it is on the seam
            start, along = rng.uniform((200.0, 200.0), (800.0, 600.0)), rng.normal(size=2) * 0.02
            along[1] = rng.choice([-1.0, 1.0])
        elapsed = time_s + delay_s[:, target] - time_s.mean()
        position[:, target] = start + elapsed[:, None] * speed * along
        position[:, target] += sigma * rng.normal(size=(looks, 2))
    order = np.argsort(rng.random((looks, detections)), axis=1)
    return Scan(
        time_s=time_s,
        valid=np.ones(looks, bool),
        position_m=np.take_along_axis(position, order[..., None], axis=1),
        mask=np.ones((looks, detections), bool),
        weight=rng.uniform(0.3, 1.0, (looks, detections)),
        delay_s=np.take_along_axis(delay_s, order, axis=1),
    )  # pyright: ignore[reportArgumentType]


def with_nan_behind_masks(scan):
    """Return the looks with NaN wherever no detection counts."""
    counts = scan.mask & scan.valid[:, None]
    hide = lambda x: (
        None
        if x is None
        else np.where(counts.reshape(counts.shape + (1,) * (x.ndim - 2)), x, np.nan)
    )
    return scan._replace(
        position_m=hide(scan.position_m),
        weight=hide(scan.weight),
        delay_s=hide(scan.delay_s),
        covariance_m2=hide(scan.covariance_m2),
    )


@st.composite
def looks(draw, shapes=SHAPES):
    """Random looks; drawn detections are missing, are worth nothing, or stand in a lost look."""
    shape = draw(st.sampled_from(shapes))
    scan = random_looks(np.random.default_rng(draw(st.integers(0, 2**32 - 1))), *shape)
    places = st.integers(0, shape[0] * shape[1] - 1)
    scan.mask.flat[draw(st.lists(places, max_size=shape[0] * shape[1] // 3))] = False
    scan.weight.flat[draw(st.lists(places, max_size=2))] = 0.0  # pyright: ignore
    scan.valid[draw(st.lists(st.integers(0, shape[0] - 1), max_size=1))] = False
    return with_nan_behind_masks(scan)


def expected_lines(queries, read, refine, settings, origin, max_lines):
    """Return lines (ρ, θ, votes) from (0, 0): the queries' values, greedy peaks, refinement."""
    valued = [(rho, theta, read((rho, theta))) for rho, theta in queries]
    separation = settings.separation_rho_m, settings.separation_theta_rad
    return lines_of(peaks.greedy(valued, *separation, max_lines), refine, settings, origin)


def lines_of(found, refine, settings, origin):
    """Return lines (ρ, θ, votes) from (0, 0): peaks refined, told apart and gated."""
    refined = [(*refine((peak.rho, peak.theta)), float(peak.votes)) for peak in found]
    separation = settings.separation_rho_m, settings.separation_theta_rad
    return [
        (lines.measured_from_zero(rho, theta, origin), theta, value)
        for rho, theta, value in peaks.distinct(refined, *separation)
        if value >= settings.gate
    ]


def assert_same_lines(got, expected, *, rtol=1e-10, rho_atol=1e-8, theta_atol=1e-10):
    """Check the table of lines against a list of (ρ, θ, votes)."""
    count = len(expected)
    np.testing.assert_array_equal(got.mask, np.arange(len(got.mask)) < count)
    np.testing.assert_allclose(got.votes[:count], [e[2] for e in expected], rtol=rtol)
    for n, (rho, theta, _) in enumerate(expected):
        assert 0.0 <= float(got.theta_rad[n]) < math.pi
        d_rho, d_theta = lines.difference(float(got.rho_m[n]), float(got.theta_rad[n]), rho, theta)
        assert abs(d_rho) <= rho_atol
        assert abs(d_theta) <= theta_atol
    for table in got[:3]:
        np.testing.assert_array_equal(table[count:], 0.0)


def assert_same_info(info, got, scan, settings):
    """Check relative votes and members of the lines found."""
    strongest = max(float(got.votes[0]), 1e-300)
    np.testing.assert_allclose(info.relative_votes, np.asarray(got.votes) / strongest, rtol=1e-12)
    for n, there in enumerate(got.mask):
        members = peaks.members(
            float(got.rho_m[n]), float(got.theta_rad[n]), scan, settings.member_m
        )
        np.testing.assert_array_equal(info.members[n], members & bool(there))
    assert not info.overflow
