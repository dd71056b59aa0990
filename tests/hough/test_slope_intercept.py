"""The slope–intercept transform: hard votes against the loop, soft ones against the direct sum."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from jaxtrack.hough.slope_intercept import (
    LineGrid,
    LineSizes,
    Points,
    cell_centres,
    grouped_votes,
    hard_votes,
    points_of,
    soft_votes,
)
from jaxtrack.types import Scan
from tests.metrics.differences import assert_gradients_agree
from tests.oracles import csht

pytestmark = pytest.mark.slow  # compiles for minutes where nothing is cached

GRID = LineGrid(-3.0, 0.5, -10.0, 4.0)
SIZES = LineSizes(velocities=13, positions=11, fine=4)
CELLS = (-3.0, 13, 0.5, -10.0, 11, 4.0)
HIGH = -10.0 + 11 * 4.0
hard = jax.jit(hard_votes, static_argnames="sizes")
soft = jax.jit(soft_votes, static_argnames="sizes")


def random_points(seed, *, looks=5, size=4):
    """Return points of which some are nowhere and some vote outside the grid."""
    rng = np.random.default_rng(seed)
    time = np.broadcast_to(np.sort(rng.uniform(0.0, 9.0, looks))[:, None], (looks, size))
    weight = rng.uniform(0.2, 1.0, (looks, size)) * (rng.random((looks, size)) < 0.8)
    return Points(time, rng.uniform(-20.0, 50.0, (looks, size)), weight)


def as_list(points):
    return list(zip(*(x.ravel() for x in points), strict=True))


@pytest.mark.parametrize("seed", range(8))
def test_hard_votes_equal_the_loop(seed):
    points = random_points(seed)
    got = hard(points, GRID, sizes=SIZES)
    np.testing.assert_allclose(got, csht.hard_votes(as_list(points), CELLS), atol=1e-12)
    assert got.sum() < 13 * points.weight.sum()  # some votes were outside, and are dropped
    place = np.full_like(points.position_m, 10.0)
    whole = points._replace(position_m=place, time_s=0 * points.time_s)
    np.testing.assert_allclose(hard(whole, GRID, sizes=SIZES).sum(), 13 * points.weight.sum())


def test_groups_vote_by_themselves():
    points = random_points(3)
    group = np.random.default_rng(0).integers(0, 3, points.weight.shape)
    got = grouped_votes(points, jnp.asarray(group), GRID, groups=3, sizes=SIZES)
    for n in range(3):
        mine = points._replace(weight=np.where(group == n, points.weight, 0.0))
        np.testing.assert_allclose(got[n], hard(mine, GRID, sizes=SIZES), atol=1e-12)


@pytest.mark.parametrize("fine", [1, 2, 4, 16])
@pytest.mark.parametrize("sigma", [1.0, 3.0, 8.0])
def test_soft_votes_are_within_their_bound_of_the_direct_sum(fine, sigma):
    sizes = SIZES._replace(fine=fine)
    bound = 0.0605 * (4.0 / fine / sigma) ** 2
    worst = 0.0
    for seed in range(4):
        points = random_points(seed)
        r = points.position_m[..., None] - points.time_s[..., None] * np.arange(-3.0, 3.5, 0.5)
        step = 4.0 / fine
        # Votes that fade out next to the grid are neither counted nor dropped: leave them out.
        fading = ((r < -10.0) & (r > -10.0 - step)) | ((r > HIGH) & (r < HIGH + step))
        points = points._replace(weight=np.where(fading.any(-1), 0.0, points.weight))
        expected = csht.direct_shares(as_list(points), CELLS, sigma)
        error = np.abs(soft(points, GRID, sigma, sizes=sizes) - expected).max()
        assert error <= bound * points.weight.sum() + 1e-12
        sixth = np.arange(20).reshape(5, 4) == 6
        single = points._replace(weight=np.where(sixth & (points.weight > 0), 1.0, 0.0))
        expected = csht.direct_shares(as_list(single), CELLS, sigma)
        worst = max(worst, np.abs(soft(single, GRID, sigma, sizes=sizes) - expected).max())
    assert worst <= bound + 1e-12


def test_the_bound_is_nearly_reached():
    """A vote midway between two nodes, σ from the edge where the curvature is largest."""
    sizes, sigma = SIZES._replace(fine=8, positions=40), 1.5
    grid, cells = LineGrid(0.0, 1.0, 0.0, 6.0), (0.0, 1, 1.0, 0.0, 40, 6.0)
    sizes = sizes._replace(velocities=1)
    worst = 0.0
    for n in 60.0 + 0.75 * (np.arange(16) + 0.5):
        points = Points(np.zeros((1, 1)), np.full((1, 1), n), np.ones((1, 1)))
        direct = csht.direct_shares([(0, n, 1)], cells, sigma)
        error = soft(points, grid, sigma, sizes=sizes) - direct
        worst = max(worst, np.abs(error).max())
    bound = 0.0605 * (0.75 / sigma) ** 2
    assert 0.3 * bound < worst <= bound


def test_soft_votes_tend_to_hard_ones():
    rng = np.random.default_rng(1)
    points = random_points(2)
    # Velocity 0 only, away from the edges of cells.
    points = points._replace(
        time_s=points.time_s * 0.0,
        position_m=4.0 * rng.integers(-2, 8, (5, 4)) - 10.0 + rng.uniform(0.5, 3.5, (5, 4)),
    )
    got = soft(points, GRID, 0.02, sizes=SIZES._replace(fine=32))
    np.testing.assert_allclose(got, hard(points, GRID, sizes=SIZES), atol=1e-6)


def test_gradients_agree_with_central_differences():
    points = random_points(5, looks=3, size=2)
    weights = np.random.default_rng(0).normal(size=(13, 11))

    def loss(position, weight, sigma):
        votes = soft_votes(Points(points.time_s, position, weight), GRID, sigma, sizes=SIZES)
        return (votes * weights).sum() + (votes**2).sum()

    assert_gradients_agree(loss, points.position_m, points.weight, 3.0, step=1e-6, atol=1e-6)


def test_points_come_from_what_counts():
    mask = np.array([[True, False], [True, True], [True, True]])
    scans = Scan(
        time_s=np.array([np.nan, 5.0, 7.0]),
        valid=np.array([False, True, True]),
        position_m=np.arange(12.0).reshape(3, 2, 2),
        mask=mask,
        weight=np.full((3, 2), 0.5),
        delay_s=np.full((3, 2), 0.25),
    )  # pyright: ignore[reportArgumentType]
    points = points_of(scans, 1)
    np.testing.assert_array_equal(points.time_s, [[0.0, 0.0], [0.25, 0.25], [2.25, 2.25]])
    np.testing.assert_array_equal(points.position_m, [[0.0, 0.0], [5.0, 7.0], [9.0, 11.0]])
    np.testing.assert_array_equal(points.weight, [[0.0, 0.0], [0.5, 0.5], [0.5, 0.5]])


def test_single_precision_stays_single_and_sizes_are_checked():
    points = Points(*(x.astype(np.float32) for x in random_points(0)))
    assert hard(points, GRID, sizes=SIZES).dtype == np.float32
    assert soft(points, GRID, 3.0, sizes=SIZES).dtype == np.float32
    velocity, position = cell_centres(GRID, sizes=SIZES, dtype=jnp.dtype(np.float32))
    assert velocity.dtype == position.dtype == np.float32
    with pytest.raises(ValueError, match=r"sigma_m: got -3\.0, want a positive number"):
        soft_votes(points, GRID, -3.0, sizes=SIZES)
    with pytest.raises(ValueError, match=r"sizes\.fine: got 0"):
        soft_votes(points, GRID, 3.0, sizes=SIZES._replace(fine=0))
    with pytest.raises(ValueError, match=r"points\.weight: got shape"):
        hard_votes(points._replace(weight=np.ones(3)), GRID, sizes=SIZES)
