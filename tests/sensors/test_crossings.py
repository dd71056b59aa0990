"""Two targets that meet, and the statistics of their echoes."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from jaxtrack.sensors import EchoSensor, Meeting, meeting_targets, observe_echoes, situations
from jaxtrack.sensors.crossings import FIELD_M, MEETING_LOOK, MEETING_M
from tests.oracles import crossings as oracle

RUNS, LOOKS = 400, 24
SENSOR = EchoSensor(0.8, 3.0, 0.5, 0.02)


@pytest.fixture(scope="module")
def seen():
    def one(key):
        first, second = jax.random.split(key)
        truth = meeting_targets(first, Meeting(0.5, 0.0, 0.05))
        return truth, observe_echoes(second, truth, SENSOR, echoes=20, clutter=60)

    return jax.jit(jax.vmap(one))(jax.random.split(jax.random.key(3), RUNS))


def assert_near(values, expected):
    """Within four standard errors of the mean."""
    values = np.asarray(values, float).ravel()
    error = values.std(ddof=1) / np.sqrt(values.size)
    assert abs(values.mean() - expected) < 4 * error, (values.mean(), expected, error)


def test_rates_are_those_that_were_asked_for(seen):
    _, looks = seen
    assert not looks.overflow.any()
    counts = np.stack([(looks.origin == k).sum(-1) for k in range(2)])
    assert_near(counts > 0, 0.8)
    assert_near(counts[counts > 0], 3.0)
    assert counts[counts > 0].var() == pytest.approx(2.0, rel=0.05)  # 1 + Poisson(2)
    clutter = np.asarray(looks.scans.mask & (looks.origin < 0)).sum(-1)
    assert_near(clutter, 0.02 * FIELD_M**2)
    assert clutter.var() == pytest.approx(0.02 * FIELD_M**2, rel=0.06)


def test_echoes_lie_about_their_target_and_clutter_in_the_field(seen):
    truth, looks = seen
    at, origin = np.asarray(looks.scans.position_m), np.asarray(looks.origin)
    own = origin >= 0
    centre = np.take_along_axis(
        np.asarray(truth.state)[..., :2], np.where(own, origin, 0)[..., None], axis=2
    )
    apart = (at - centre)[own]
    for axis in range(2):
        assert_near(apart[:, axis], 0.0)
        assert_near(apart[:, axis] ** 2, 0.25)
    assert_near(apart[:, 0] * apart[:, 1], 0.0)
    false = at[np.asarray(looks.scans.mask) & ~own]
    assert false.min() >= 0.0
    assert false.max() <= FIELD_M
    assert_near(false, FIELD_M / 2)
    assert_near((false - FIELD_M / 2) ** 2, FIELD_M**2 / 12)


def test_places_are_in_random_order(seen):
    _, looks = seen
    places = looks.origin.shape[-1]
    where = np.nonzero(np.asarray(looks.origin) == 0)[-1]
    assert_near(where, (places - 1) / 2)


def test_targets_meet_where_and_when_they_are_said_to(seen):
    truth, _ = seen
    meet = np.asarray(truth.state)[:, MEETING_LOOK]
    course = np.array([np.cos([0.25, 0.25]), np.sin([0.25, -0.25])]).T
    want = np.concatenate([[MEETING_M] * 2, 1.25 * course], axis=1)
    np.testing.assert_allclose(meet, np.broadcast_to(want, meet.shape), atol=1e-12)
    apart = Meeting(0.0, 8.0)
    short, whole = (meeting_targets(jax.random.key(1), apart, looks=looks) for looks in (5, 13))
    np.testing.assert_allclose(whole.state[12, :, 1], [23.0, 31.0], atol=1e-12)
    np.testing.assert_allclose(short.state, whole.state[:5], atol=1e-12)


def test_accelerations_are_white(seen):
    truth, _ = seen
    velocity = np.asarray(truth.state)[..., 2:]
    push = np.diff(velocity, axis=1)
    assert_near(push, 0.0)
    assert_near(push**2, 0.05**2)
    position = np.diff(np.asarray(truth.state)[..., :2], axis=1)
    np.testing.assert_allclose(position, (velocity[:, 1:] + velocity[:, :-1]) / 2, atol=1e-12)


def test_counts_have_the_moments_of_a_loop(seen):
    truth, looks = seen
    rng = np.random.default_rng(0)
    loop = [
        len(oracle.look(rng, state, *SENSOR, FIELD_M))
        for state in np.asarray(truth.state)[:100].reshape(-1, 2, 4)
    ]
    ours = np.asarray(looks.scans.mask).sum(-1).ravel()
    error = np.hypot(np.std(loop) / np.sqrt(len(loop)), ours.std() / np.sqrt(ours.size))
    assert abs(np.mean(loop) - ours.mean()) < 4 * error
    assert ours.std() == pytest.approx(np.std(loop), rel=0.1)


def test_paths_meet_where_they_should_inside_the_field():
    path = jax.jit(lambda meeting: meeting_targets(jax.random.key(0), meeting).state)
    for name, (meeting, _) in situations().items():
        straight = np.asarray(path(Meeting(*map(jnp.asarray, meeting))._replace(sigma_a_m_s2=0.0)))
        apart = np.linalg.norm(straight[:, 0, :2] - straight[:, 1, :2], axis=-1)
        assert apart[12] == pytest.approx(meeting.gap_m, abs=1e-12), name
        if meeting.angle_rad == 0.0:  # side by side
            np.testing.assert_allclose(apart, meeting.gap_m, atol=1e-12)
        else:
            assert np.delete(apart, 12).min() > apart[12] + 0.5
        np.testing.assert_allclose(straight[12, :, :2].mean(0), MEETING_M)
        np.testing.assert_allclose(np.linalg.norm(straight[..., 2:], axis=-1), 1.25)
        course = np.arctan2(straight[0, :, 3], straight[0, :, 2])
        assert course[0] - course[1] == pytest.approx(meeting.angle_rad)
        assert straight[0, 0, 1] < straight[0, 1, 1]  # the first comes from below
        assert straight[..., :2].min() > 0.0
        assert straight[..., :2].max() < FIELD_M


@pytest.mark.slow
def test_what_does_not_fit_is_said():
    truth = meeting_targets(jax.random.key(0), Meeting(0.0, 8.0))
    crowded = observe_echoes(jax.random.key(1), truth, EchoSensor(), echoes=1, clutter=1)
    assert bool(crowded.overflow)
    single = EchoSensor(echoes=1.0, clutter_per_m2=0.0)
    fits = observe_echoes(jax.random.key(1), truth, single, echoes=1, clutter=1)
    assert not bool(fits.overflow)
    with pytest.raises(ValueError, match="echoes: got 0"):
        observe_echoes(jax.random.key(1), truth, single, echoes=0, clutter=1)
