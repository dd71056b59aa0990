"""Figures of the sonar study show what has votes, and say what they draw."""

import numpy as np

from jaxtrack import plots
from jaxtrack.models import BeamSonar
from jaxtrack.types import Pose, Scan
from tests.plots.test_plots import draw, legend


def test_vote_planes_show_what_has_votes_and_marks():
    votes = np.zeros((3, 50))
    votes[1, 10:13] = 2.0
    starts = np.arange(50.0) * 4
    low, high = plots.vote_plane(votes, [-1.0, 0.0, 1.0], starts).axes[0].get_ylim()
    assert (low, high) == (36.0, 52.0)
    figure = plots.vote_plane(votes, [-1.0, 0.0, 1.0], starts, centres=[[0.0, 100.0]])
    assert figure.axes[0].get_ylim()[1] == 104.0
    assert plots.vote_plane(0 * votes, [-1.0, 0.0, 1.0], starts).axes[0].get_ylim()[1] > 190.0


def test_points_stand_beside_their_votes(tmp_path):
    time_s = np.arange(4.0)
    mask = np.array([[True, False]] * 4)
    position = np.where(mask[..., None], (5 + 2 * time_s)[:, None, None], np.nan) * np.ones(2)
    scans = Scan(time_s, np.ones(4, bool), position, mask)  # pyright: ignore
    figure = plots.points_and_votes(scans, [2.0, 5.0], np.eye(3), [1.0, 2.0, 3.0], [0.0, 5.0, 9.0])
    points, line = (part.get_xydata() for part in figure.axes[0].get_lines())
    np.testing.assert_allclose(points[:, 1], [5.0, 7.0, 9.0, 11.0])
    np.testing.assert_allclose(line, [[0.0, 5.0], [3.0, 11.0]])
    assert legend(figure) == ["detections", "true line", "true velocity and initial position"]
    draw(figure, tmp_path)


def test_frames_tell_range_and_bearing_of_a_target_and_show_it(tmp_path):
    # Heading east, the target 30 m ahead and 40 m to port, that is north.
    pose = Pose(np.array([10.0, 20.0]), np.array(np.pi / 2))
    figure = plots.sonar_frames(pose, BeamSonar(), np.array([50.0, 50.0]))
    words = {text.get_text() for text in figure.axes[0].texts}
    assert {"ρ = 50 m", "ψ = 90°", "α = -53°", "ahead", "starboard", "north"} <= words
    shown = {line.get_label(): line.get_xydata() for line in figure.axes[0].get_lines()}
    np.testing.assert_allclose(shown["target"], [[50.0, 50.0]])
    np.testing.assert_allclose(shown["sonar"], [[20.0, 10.0]])
    draw(figure, tmp_path)


def test_error_bars_say_what_they_are():
    curve = ([0.1, 0.3], [1.0, 1.2], [0.1, 0.2])
    figure = plots.error_curves({"": {"joint": curve}}, x_label="P_F", y_label="OSPA, m")
    assert figure.axes[0].get_ylabel() == "OSPA, m\nmean ± 2 standard errors"
    bars = figure.axes[0].containers[0].lines[2][0].get_segments()
    np.testing.assert_allclose(bars[1][:, 1], [0.8, 1.6])
