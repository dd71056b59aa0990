import numpy as np
import pytest

from jaxtrack.io import covariance_from_polar, position_from_polar

DEGREE = np.pi / 180.0


@pytest.mark.parametrize(
    ("bearing_deg", "north_m", "east_m"),
    [(0.0, 10.0, 0.0), (90.0, 0.0, 10.0), (180.0, -10.0, 0.0), (-90.0, 0.0, -10.0)],
)
def test_compass_bearings_give_north_and_east(bearing_deg, north_m, east_m):
    position_m = position_from_polar(10.0, bearing_deg * DEGREE)
    np.testing.assert_allclose(position_m, [north_m, east_m], atol=1e-12)


@pytest.mark.parametrize(
    ("bearing_deg", "x_m", "y_m"),
    [(0.0, 10.0, 0.0), (90.0, 0.0, 10.0), (180.0, -10.0, 0.0), (270.0, 0.0, -10.0)],
)
def test_math_bearings_turn_counter_clockwise_from_x(bearing_deg, x_m, y_m):
    position_m = position_from_polar(10.0, bearing_deg * DEGREE, bearing="math")
    np.testing.assert_allclose(position_m, [x_m, y_m], atol=1e-12)


def test_both_conventions_point_to_the_same_place_on_a_map():
    compass_deg = np.arange(0.0, 360.0, 15.0)
    north_east_m = position_from_polar(7.0, compass_deg * DEGREE)
    # A map's axes are x east, y north: the counter-clockwise angle from x is 90° less the compass'.
    x_y_m = position_from_polar(7.0, (90.0 - compass_deg) * DEGREE, bearing="math")
    np.testing.assert_allclose(x_y_m, north_east_m[:, ::-1], atol=1e-12)


def test_own_ship_is_added_and_turns_the_bearing():
    # Heading east, a target on the starboard beam lies south of own ship.
    position_m = position_from_polar(
        [5.0, 5.0], 90 * DEGREE, own_position_m=[100.0, 200.0], own_heading_rad=90 * DEGREE
    )
    np.testing.assert_allclose(position_m, [[95.0, 200.0]] * 2, atol=1e-12)


def test_covariance_agrees_with_samples():
    rng = np.random.default_rng(3)
    range_m, bearing_rad, heading_rad, sigma_m, sigma_rad = 400.0, 0.7, 0.4, 3.0, 0.02
    samples_m = position_from_polar(
        range_m + sigma_m * rng.standard_normal(400_000),
        bearing_rad + sigma_rad * rng.standard_normal(400_000),
        own_heading_rad=heading_rad,
    )
    covariance_m2 = covariance_from_polar(
        range_m, bearing_rad, sigma_m, sigma_rad, own_heading_rad=heading_rad
    )
    np.testing.assert_allclose(covariance_m2, np.cov(samples_m.T), rtol=0.02)
    np.testing.assert_array_equal(covariance_m2, covariance_m2.T)


def test_an_unknown_convention_is_named():
    with pytest.raises(
        ValueError, match="bearing: got 'compass', want one of clockwise_from_north"
    ):
        position_from_polar(1.0, 0.0, bearing="compass")
