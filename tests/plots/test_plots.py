"""Figures hold what they were given; empty data do not stop them."""

import math

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from matplotlib.figure import Figure

from jaxtrack import plots
from jaxtrack.models import BeamSonar
from jaxtrack.plots.accumulations import _coarse
from jaxtrack.plots.sinusoids import _nearest_line
from jaxtrack.sensors import (
    IMAGENEX_881L,
    PingSizes,
    ScanningPreset,
    cloud_of_pings,
    crossing_targets,
    dragged_bucket,
    observe,
)
from jaxtrack.tuning import FitHistory, FitResult
from jaxtrack.types import Pose, Scan, Tracks


def draw(figure: Figure, tmp_path) -> None:
    path = tmp_path / "figure.png"
    figure.savefig(path)
    assert path.read_bytes().startswith(b"\x89PNG")
    assert path.stat().st_size > 2000


def three_tracks(time_s: float, states: np.ndarray) -> Tracks:
    slots = len(states)
    one = np.ones(slots)
    mask = np.arange(slots) < slots - 1  # the last slot is empty
    mean = np.where(mask[:, None], states, np.nan)
    identity = np.where(mask, 10 + np.arange(slots), -1)
    return Tracks(np.asarray(time_s), mean, np.zeros((slots, 4, 4)), mask, identity, one, one, one)


def legend(figure: Figure) -> list[str]:
    return [text.get_text() for text in figure.legends[0].get_texts()]


@pytest.fixture(scope="module")
def crossing():
    scene = crossing_targets("IV", 10.0)
    return scene.truth, observe(jax.random.key(0), scene.truth, scene.radar, detections=40)


def test_scene_shows_every_detection_and_only_live_tracks(crossing, tmp_path):
    truth, scans = crossing
    states = np.concatenate([np.asarray(truth.state[-1]), np.zeros((1, 4))])
    figure = plots.scene(scans, truth, three_tracks(12.0, states), title="crossing")
    plane = figure.axes[0]
    assert plane.get_xlabel() == "x, km"
    assert plane.xaxis.get_major_formatter()(2500.0, 0) == "2.5"
    assert plane.get_title(loc="left") == "crossing"
    assert len(plane.collections[0].get_offsets()) == int(scans.mask.sum())
    assert legend(figure) == ["truth", "track 10", "track 11", "track 12"]
    by_label = {line.get_label(): line for line in plane.get_lines()}
    # Without smoothed positions a track is drawn along its velocity, back to the first look.
    for target in range(3):
        path = by_label[f"track {10 + target}"].get_xydata()
        np.testing.assert_allclose(path, np.asarray(truth.state[:, target, :2]), atol=1e-3)
    low, high = np.asarray(truth.state).min((0, 1)), np.asarray(truth.state).max((0, 1))
    assert plane.get_xlim()[0] < low[0] < high[0] < plane.get_xlim()[1]
    assert plane.get_ylim()[0] < low[1] < high[1] < plane.get_ylim()[1]
    draw(figure, tmp_path)


def test_scene_draws_north_upwards_and_smoothed_positions(crossing):
    truth, scans = crossing
    tracks = three_tracks(12.0, np.array([[0.0, 5000.0, 0.0, 100.0], [0.0] * 4]))
    smoothed = np.array([[[0.0, 4000.0], [1000.0, 5000.0]], [[np.nan] * 2] * 2])
    figure = plots.scene(None, None, tracks, smoothed_m=smoothed, axes="north_east")
    plane = figure.axes[0]
    assert (plane.get_xlabel(), plane.get_ylabel()) == ("east, m", "north, m")
    np.testing.assert_allclose(plane.get_lines()[0].get_xydata(), [[4000.0, 0.0], [5000.0, 1000.0]])
    with pytest.raises(ValueError, match="axes: got 'up'"):
        plots.scene(scans, truth, None, axes="up")


def test_scene_ignores_masked_detections_that_are_nan():
    position = np.array([[[0.0, 0.0], [np.nan, np.nan]], [[50.0, 0.0], [1e9, 1e9]]])
    mask = np.array([[True, False], [True, False]])
    scans = Scan(np.arange(2.0), np.ones(2, bool), position, mask)  # pyright: ignore
    figure = plots.scene(scans, None, None)
    assert len(figure.axes[0].collections[0].get_offsets()) == 2
    assert figure.axes[0].get_xlim()[1] < 100.0
    assert figure.axes[0].get_xlabel() == "x, m"


def test_scene_without_anything_is_an_empty_map(tmp_path):
    nothing = Scan(np.arange(2.0), np.ones(2, bool), np.zeros((2, 1, 2)), np.zeros((2, 1), bool))  # pyright: ignore
    for scans in (None, nothing):
        figure = plots.scene(scans, None, None)
        assert "no detections" in figure.axes[0].texts[0].get_text()
        draw(figure, tmp_path)


def test_sinusoids_meet_in_the_line(tmp_path):
    points = np.array([[0.0, 80.0], [300.0, 80.0], [900.0, 80.0]])
    figure = plots.sinusoids(points, title="figure 2")
    plane, space = figure.axes
    assert len(plane.get_lines()) == 4  # three points and their line
    curves, meeting = space.get_lines()[:3], space.get_lines()[3].get_xydata()[0]
    np.testing.assert_allclose(meeting, [np.pi / 2, 80.0], atol=1e-6)
    for curve in curves:
        theta, rho = curve.get_data()
        assert abs(np.interp(meeting[0], theta, rho) - meeting[1]) < 1e-6
    draw(figure, tmp_path)
    draw(plots.sinusoids(np.zeros((0, 2))), tmp_path)
    draw(plots.sinusoids([[3.0, 4.0]]), tmp_path)


def test_nearest_line_of_an_upright_line():
    rho, theta = _nearest_line(np.array([[-5.0, 0.0], [-5.0, 10.0]]))
    assert (rho, theta) == pytest.approx((-5.0, 0.0)) or (rho, theta) == pytest.approx(
        (5.0, math.pi)
    )


def test_accumulations_keep_single_peaks(tmp_path):
    votes = np.zeros((3142, 1600))
    votes[1571, 1200] = 7.0
    height, theta, rho = _coarse(votes, 4.0)
    assert height.max() == 7.0
    assert (height > 0).sum() == 1
    j, i = np.argwhere(height > 0)[0]
    assert theta[j] <= math.pi / 2 * 1.001
    assert theta[j + 1] >= math.pi / 2 * 0.999
    assert rho[i] <= 2.0 < rho[i + 1] + 1e-9
    panels = {"one": votes, "none": np.zeros((90, 100)), "jax": jnp.ones((20, 30))}
    figure = plots.accumulations(panels, 4000.0, title="votes", marks=[(2000.0, 1.57)])
    assert [axes.get_title(loc="left") for axes in figure.axes] == list(panels)
    assert figure.axes[0].get_xlim() == (-4.0, 4.0)
    assert [len(axes.get_lines()) for axes in figure.axes] == [2, 2, 2]
    draw(figure, tmp_path)
    draw(plots.accumulations({}, 4000.0), tmp_path)


def test_run_times_show_methods_and_the_paper(tmp_path):
    figure = plots.run_times([10, 56], {"joint": [4e-3, 2e-2], "mine": [1e-3, 2e-3]}, {"joint": 1})
    axes = figure.axes[0]
    assert axes.get_yscale() == "log"
    assert legend(figure) == ["joint", "mine", "the paper, on its machine"]
    np.testing.assert_allclose(axes.get_lines()[0].get_ydata(), [4e-3, 2e-2])
    low, high = axes.get_ylim()
    assert low < 1e-3 < 1 < high
    draw(figure, tmp_path)
    draw(plots.run_times([], {}), tmp_path)


def test_scores_place_every_share(tmp_path):
    shares = {
        "standard": {"I": (1.0, 0.99, 1.0), "IV": (0.1, 0.05, 0.16)},
        "joint": {"I": (1.0, 0.99, 1.0), "IV": (0.95, 0.93, 0.97)},
    }
    figure = plots.scores(shares, title="all found", marks={"IV": 0.9})
    axes = figure.axes[0]
    assert [tick.get_text() for tick in axes.get_xticklabels()] == ["I", "IV"]
    assert legend(figure) == ["standard", "joint", "wanted"]
    assert len(axes.containers) == 2
    np.testing.assert_allclose(axes.containers[1].lines[0].get_ydata(), [100.0, 95.0])
    assert axes.get_ylim() == (0.0, 100.0)
    draw(figure, tmp_path)
    draw(plots.scores({}), tmp_path)


def test_a_method_has_one_colour_in_all_figures():
    times = plots.run_times([1, 2], {"joint": [1.0, 2.0]})
    both = plots.scores({"standard": {"I": (0.5, 0.4, 0.6)}, "joint": {"I": (0.5, 0.4, 0.6)}})
    colour = both.axes[0].containers[1].lines[0].get_color()
    assert colour == times.axes[0].get_lines()[0].get_color()
    assert colour != both.axes[0].containers[0].lines[0].get_color()


def test_a_sweep_is_drawn_where_its_pings_poses_put_it(tmp_path):
    sonar = IMAGENEX_881L.sonar
    preset = ScanningPreset(sonar, PingSizes(bins=100, facets=4, rays=2))
    run = jax.jit(lambda key: dragged_bucket(key, "following", frames=2, preset=preset))
    found = run(jax.random.key(0))
    # The second sweep turns to port.
    sweep = jax.tree.map(lambda x: x[1], found.pings)
    truth = jax.tree.map(lambda x: x[1:], found.truth)
    cloud, _ = cloud_of_pings(sweep, sonar)
    figure = plots.pings_map(sweep, sonar, cloud, truth, title="a sweep")
    plane = figure.axes[0]
    assert (plane.get_xlabel(), plane.get_title(loc="left")) == ("east, m", "a sweep")
    assert legend(figure) == ["sonar", "cloud", "truth"]
    by_label = {line.get_label(): line.get_xydata() for line in plane.get_lines()}
    points = np.asarray(cloud.position_m)[np.asarray(cloud.mask)][:, ::-1]
    np.testing.assert_allclose(by_label["cloud"], points)
    np.testing.assert_allclose(by_label["truth"], np.asarray(truth.state[0, :, 1::-1]))
    mesh = plane.collections[0]
    level_db = 20 * np.log10(np.asarray(sweep.intensity))
    np.testing.assert_allclose(np.asarray(mesh.get_array()).reshape(101, 100), level_db, rtol=1e-6)
    # Every point of the cloud lies in its own cell: the nearest middle is within half a cell.
    corner = mesh.get_coordinates()
    middle = (corner[1:, 1:] + corner[:-1, :-1] + corner[1:, :-1] + corner[:-1, 1:]) / 4
    loud = middle[np.asarray(sweep.intensity) >= 4.0]
    gap = np.linalg.norm(points[:, None] - loud[None], axis=-1)
    assert gap.min(axis=0).max() < 0.05
    draw(figure, tmp_path)

    paths_m = {"ours": np.arange(12.0).reshape(3, 2, 2), "theirs": np.ones((3, 2, 2))}
    tracked = plots.pings_map(sweep, sonar, paths_m=paths_m)
    assert legend(tracked) == ["sonar", "ours", "theirs"]
    lines = tracked.axes[0].get_lines()[1:]
    assert [line.get_xydata().tolist() for line in lines[:2]] == [
        [[1.0, 0.0], [5.0, 4.0], [9.0, 8.0]],
        [[3.0, 2.0], [7.0, 6.0], [11.0, 10.0]],
    ]
    assert lines[0].get_color() == lines[1].get_color() != lines[2].get_color()
    near = plots.pings_map(sweep, sonar, cloud, truth, around_m=4.0, axes="x_y").axes[0]
    at = np.asarray(truth.state[0, 0, :2])
    np.testing.assert_allclose([near.get_xlim(), near.get_ylim()], at[:, None] + [[-4.0, 4.0]])
    none = sweep._replace(mask=np.zeros(101, bool))
    draw(plots.pings_map(none, sonar), tmp_path)
    with pytest.raises(ValueError, match=r"around_m: got 4.0 without a true target"):
        plots.pings_map(sweep, sonar, around_m=4.0)
    with pytest.raises(ValueError, match="axes: got 'polar'"):
        plots.pings_map(sweep, sonar, axes="polar")


def a_fit(steps=6):
    history = FitHistory(
        loss=np.linspace(3.0, 1.0, steps),
        loss_error=np.full(steps, 0.1),
        grad_norm=np.ones(steps),
        finite=np.ones(steps, bool),
        params={"eps_m": np.geomspace(1.0, 50.0, steps + 1), "bias": np.zeros((steps + 1, 2))},
        evaluated=np.array([0, 3, 6]),
        held_out=np.array([3.0, 2.0, 2.5]),
        held_out_error=np.full(3, 0.2),
        realizations=np.array([8, 32, 56]),
    )
    return FitResult(None, 3, 2.0, 0.2, False, history)


def test_a_fit_shows_losses_parameters_and_the_step_that_was_kept(tmp_path):
    result = a_fit()
    figure = plots.fit_history(result, title="a fit")
    top, bias, eps = figure.axes
    assert [axes.get_ylabel() for axes in figure.axes] == ["loss", "bias", "eps_m"]
    assert [axes.get_yscale() for axes in figure.axes] == ["linear", "linear", "log"]
    np.testing.assert_array_equal(top.get_lines()[0].get_ydata(), result.history.loss)
    np.testing.assert_array_equal(top.containers[0].lines[0].get_ydata(), [3.0, 2.0, 2.5])
    np.testing.assert_array_equal(eps.get_lines()[0].get_ydata(), result.history.params["eps_m"])
    assert len(bias.get_lines()) == 3  # two entries, and the mark
    for axes in figure.axes:
        assert list(axes.get_lines()[-1].get_xdata()) == [3, 3]
    assert legend(figure) == ["batch", "held out, ± standard error"]
    draw(figure, tmp_path)


def test_a_map_of_the_loss_has_every_way_from_its_start_to_its_end(tmp_path):
    x, y = np.geomspace(1.0, 100.0, 5), np.linspace(-1.0, 1.0, 4)
    loss = np.log(x)[:, None] ** 2 + y[None, :] ** 2
    path = np.array([[80.0, 0.9], [10.0, 0.4], [1.2, 0.0]])
    figure = plots.loss_map(
        x, y, loss, {"one": path, "two": path[:1]}, x_label="ε, m", y_label="bias",
        points={"paper": (20.0, -0.5)}, title="map",
    )  # fmt: skip
    axes = figure.axes[0]
    assert (axes.get_xscale(), axes.get_yscale()) == ("log", "linear")
    assert legend(figure) == ["one", "two", "paper"]
    lines = axes.get_lines()
    np.testing.assert_array_equal(lines[0].get_xydata(), path)
    np.testing.assert_array_equal(lines[2].get_xydata(), path[:1])
    np.testing.assert_array_equal(lines[3].get_xydata(), path[-1:])
    np.testing.assert_array_equal(lines[-1].get_xydata(), [[20.0, -0.5]])
    draw(figure, tmp_path)
    flat = plots.loss_map(x, y, np.ones((5, 4)), {}, x_label="a", y_label="b")
    draw(flat, tmp_path)
    empty = plots.loss_map([], [], np.zeros((0, 0)), {}, x_label="a", y_label="b")
    assert empty.axes[0].texts[0].get_text() == "no losses"


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


def test_means_have_a_line_a_name_and_a_colour_a_group(tmp_path):
    ways = {"score": {"σ": (0.4, 0.1), "P_F": (0.2, math.inf)}, "differences": {"P_F": (0.1, 0.2)}}
    figure = plots.means(ways, label="OSPA, m", title="What matters")
    (axes,) = figure.axes
    assert [text.get_text() for text in axes.get_yticklabels()] == ["σ", "P_F"]
    assert legend(figure) == ["score", "differences"]
    first, second = (container.lines[0].get_xydata() for container in axes.containers)
    np.testing.assert_allclose(first[:, 0], [0.4, 0.2])
    assert first[1, 1] < second[0, 1]  # beside each other
    (bars,) = axes.containers[0].lines[2]
    np.testing.assert_allclose(bars.get_segments()[0][:, 0], [0.2, 0.6])
    np.testing.assert_allclose(bars.get_segments()[1][:, 0], [0.2, 0.2])  # no error is known
    draw(figure, tmp_path)
    draw(plots.means({}, label="OSPA, m"), tmp_path)
