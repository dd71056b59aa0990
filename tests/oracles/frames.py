"""Frames by equations 1–3 of the clustering-statistic Hough transform (2018), and back."""

import math


def to_earth(range_m, bearing, vehicle, heading, mount):
    """Return the north–east position of a range and a bearing from the sonar."""
    x = range_m * math.cos(bearing) + mount[0]
    y = range_m * math.sin(bearing) + mount[1]
    north = math.cos(heading) * x - math.sin(heading) * y + vehicle[0]
    east = math.sin(heading) * x + math.cos(heading) * y + vehicle[1]
    return north, east


def to_polar(position, vehicle, heading, mount):
    """Return range and bearing: the distance, and how far the direction turns from the heading."""
    sonar = to_earth(0.0, 0.0, vehicle, heading, mount)
    north, east = position[0] - sonar[0], position[1] - sonar[1]
    turn = math.atan2(east, north) - heading
    return math.hypot(north, east), math.atan2(math.sin(turn), math.cos(turn))


def in_sight(position, vehicle, heading, sector, scope, mount=(0.0, 0.0)):
    """Return whether the sonar's sector and scope hold a position."""
    range_m, bearing = to_polar(position, vehicle, heading, mount)
    return range_m <= scope and -sector / 2 <= bearing < sector / 2
