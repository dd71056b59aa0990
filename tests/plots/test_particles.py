import numpy as np
import pytest
from matplotlib.figure import Figure

from jaxtrack import plots
from jaxtrack.types import Scan

T, P, N = 6, 5, 9


@pytest.fixture
def run():
    """Return clouds with one masked NaN a frame, the truth along y, and particles, [T, ...]."""
    rng = np.random.default_rng(0)
    truth = np.stack([np.full(T, 2.0), 10.0 + 3 * np.arange(T)], -1)
    at = truth[:, None] + rng.normal(size=(T, P, 2))
    at[:, -1] = np.nan
    mask = np.arange(P)[None] < np.array([P - 1] * T)[:, None]
    clouds = Scan(6.0 * np.arange(T), np.ones(T, bool), at, mask)
    return clouds, truth, truth[:, None] + rng.normal(size=(T, N, 2))


def drawn(figure: Figure, tmp_path):
    figure.savefig(tmp_path / "figure.png")
    return figure


def test_the_process_shows_points_particles_and_paths_so_far(run, tmp_path):
    clouds, truth, particles = run
    figure = drawn(plots.pursuit(clouds, truth, truth + 0.1, particles, until=(1, 3, T)), tmp_path)
    assert [axes.get_title(loc="left") for axes in figure.axes] == [
        "1 frame",
        "3 frames",
        "6 frames",
    ]
    for axes, count in zip(figure.axes, (1, 3, T), strict=True):
        points, cloud = (np.asarray(c.get_offsets()) for c in axes.collections)
        np.testing.assert_allclose(points, clouds.position_m[count - 1, :-1, ::-1])
        np.testing.assert_allclose(cloud, particles[count - 1, :, ::-1])
        path = {line.get_label(): line.get_xydata() for line in axes.lines}
        np.testing.assert_allclose(path["truth"], truth[:count, ::-1])
        assert len(path["estimate"]) == count


def test_a_vehicle_is_drawn_only_where_it_comes_near(run, tmp_path):
    clouds, truth, particles = run
    for vehicle, seen in ((truth - [0.0, 2.0], True), (truth - [90.0, 0.0], False)):
        figure = plots.pursuit(clouds, truth, truth, particles, until=(T,), vehicle_m=vehicle)
        labels = [line.get_label() for line in drawn(figure, tmp_path).axes[0].lines]
        assert ("vehicle" in labels) == seen


def test_templates_have_their_circle(run, tmp_path):
    clouds, truth, _ = run
    figure = drawn(plots.template_frames(clouds, truth, radius_m=1.5), tmp_path)
    assert len(figure.axes) == T
    ring = figure.axes[2].patches[0]
    np.testing.assert_allclose(ring.center, truth[2, ::-1])
    assert ring.radius == 1.5


def test_deviations_paths_and_steps_are_what_is_handed_in(run, tmp_path):
    _, truth, _ = run
    off = {"hu": np.stack([np.arange(T), -np.arange(T)], -1)}
    figure = drawn(plots.deviations(6.0 * np.arange(T), off), tmp_path)
    for axis, sign in enumerate((1, -1)):
        np.testing.assert_allclose(figure.axes[axis].lines[0].get_ydata(), sign * np.arange(T))
    figure = drawn(plots.target_paths(truth, {"hu": truth + 1}), tmp_path)
    np.testing.assert_allclose(figure.axes[0].lines[0].get_xydata(), truth[:, ::-1] + 1)
    steps = np.random.default_rng(1).normal(size=(20, 2))
    figure = drawn(plots.turned_steps(steps, np.abs(steps), [0.5, 0.5]), tmp_path)
    np.testing.assert_allclose(figure.axes[1].collections[0].get_offsets(), np.abs(steps))
