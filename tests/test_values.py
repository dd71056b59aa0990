"""Values that cannot be are refused by the argument's name, wherever they enter.

Nothing is compiled: a value that is known is looked at before anything is computed.
"""

import jax
import jax.numpy as jnp
import pytest

from jaxtrack import filtering, hough, sensors, tracking
from jaxtrack.clustering import farthest_first, fuzzy_cmeans
from jaxtrack.hough.neutrosophic import NeutrosophicParams
from jaxtrack.models import BEAMS, POSITION, BeamSensor, BeamSonar, PositionSensor
from jaxtrack.types import BeamScan, Lines, Pose, Scan, Truth

SIZES = hough.Sizes(lines=2, pairs=4, predecessors=2, candidates=4, rho=10, theta=10)
JOINT = hough.joint.JointSizes(tracks=1, hypotheses=4, candidates=4, starts=1, gap=1)
GOOD = Scan(jnp.arange(3.0), jnp.ones(3, bool), jnp.ones((3, 2, 2)), jnp.ones((3, 2), bool))
POSE = Pose(jnp.zeros((3, 2)), jnp.zeros(3))
LOUD = BeamScan(jnp.arange(3.0), jnp.ones(3, bool), jnp.ones((3, 4)), jnp.ones((3, 4), bool), POSE)
SPEED = hough.SpeedGate()
SENSOR = PositionSensor(0.9, 1e-5, 10.0)
LINES = Lines(*(jnp.ones(1) for _ in range(3)), jnp.ones(1, bool))
TRUTH = Truth(jnp.arange(3.0), jnp.zeros((3, 2, 4)), jnp.ones((3, 2), bool))
NAN, INF = float("nan"), float("inf")


def neutrosophic(**wrong):
    return hough.neutrosophic.estimate(GOOD, NeutrosophicParams(**wrong), sizes=SIZES)


def improved(**wrong):
    return hough.improved.estimate(GOOD, hough.improved.ImprovedParams(**wrong), sizes=SIZES)


def soft(eps_rho_m=1.0, eps_theta_rad=1.0):
    params = hough.modified.ModifiedParams()
    return hough.modified.soft_estimate(GOOD, params, eps_rho_m, eps_theta_rad, sizes=SIZES)


def standard(**wrong):
    return hough.standard.estimate(GOOD, hough.standard.StandardParams(**wrong), sizes=SIZES)


def joint(speed=SPEED, **wrong):
    params = hough.joint.JointParams(SENSOR._replace(**wrong), speed)
    return hough.joint.estimate(GOOD, params, sizes=JOINT)


def initiate(**wrong):
    return tracking.initiate(GOOD, LINES, tracking.InitiateParams(**wrong))


def radar(**wrong):
    truth = sensors.crossing_targets("I").truth
    return sensors.observe(jax.random.key(0), truth, sensors.Radar(**wrong), detections=4)


def rls(**wrong):
    fit = filtering.rls.rls(filtering.rls.RlsParams(**wrong), regressors=1, dimensions=1)
    seen = filtering.rls.RlsInput(jnp.ones(1), jnp.ones(1), jnp.asarray(True))
    return fit.step(fit.init(jax.random.key(0)), seen)


def sonar(**wrong):
    scene = sensors.motion_elements_scene()
    scene = scene._replace(sonar=scene.sonar._replace(**wrong))
    return sensors.observe_beams(jax.random.key(0), *scene)


def beams(**wrong):
    sensor = BeamSensor(BeamSonar()._replace(**wrong))
    params = hough.joint.JointParams(sensor)
    return hough.joint.estimate(LOUD, params, sizes=JOINT, observation=BEAMS)


def cmeans(**wrong):
    return fuzzy_cmeans(jnp.ones((3, 2)), jnp.ones(3), jnp.ones((1, 2)), **wrong)


def clustering(**wrong):
    params = hough.clustering_statistic.ClusteringParams(**wrong)
    return hough.clustering_statistic.estimate(GOOD, params)


def kalman(**wrong):
    params = tracking.KalmanTrackerParams(1.0, 0.1, 0.9, 1e-4)._replace(**wrong)
    return tracking.kalman_tracker(params, max_tracks=2)


def lifecycle(**wrong):
    return kalman(lifecycle=tracking.LifecycleParams(**wrong))


def echoes(**wrong):
    sensor = sensors.EchoSensor(**wrong)
    return sensors.observe_echoes(jax.random.key(0), TRUTH, sensor, echoes=2, clutter=2)


CASES = [
    (call, name, value)
    for call, name, values in (
        (neutrosophic, "eps_rho_m", (0.0, -1.0, NAN, INF)),
        (neutrosophic, "eps_theta_rad", (0.0, INF)),
        (neutrosophic, "p_false", (-0.1, 1.1, NAN)),
        (neutrosophic, "p_gate", (1.0, -0.1)),
        (neutrosophic, "sigma_m", (0.0, -3.0)),
        (neutrosophic, "adjustment", (-1.0,)),
        (soft, "eps_rho_m", (0.0, INF)),
        (soft, "eps_theta_rad", (-1.0, NAN)),
        (joint, "p_detect", (-0.1, 1.5, NAN)),
        (joint, "clutter_per_m2", (0.0, -1.0)),
        (joint, "sigma_m", (0.0, -1.0, INF)),
        (initiate, "sigma_m", (-1.0,)),
        (initiate, "member_m", (0.0,)),
        (initiate, "along_m", (NAN,)),
        (initiate, "min_looks", (0,)),
        (initiate, "forgetting", (0.0, 1.5)),
        (radar, "p_detect", (1.5,)),
        (radar, "sigma_m", (-1.0, NAN)),
        (radar, "clutter_per_scan", (-1.0, INF)),
        (sonar, "p_miss", (-0.1, 1.1)),
        (sonar, "p_false", (NAN,)),
        (sonar, "sigma_m", (-1.0, INF)),
        (sonar, "range_max_m", (0.0,)),
        (beams, "p_miss", (1.5,)),
        (beams, "p_false", (0.0, 1.0, NAN)),
        (beams, "sigma_m", (0.0, NAN)),
        (cmeans, "fuzzifier", (1.0, 0.5, NAN)),
        (clustering, "cell_share", (1.0, -0.1)),
        (clustering, "velocity_scale_s", (0.0,)),
        (clustering, "sigma_m", (-1.0,)),
        (rls, "forgetting", (0.0, 1.5, NAN)),
        (rls, "initial_variance", (0.0, -1.0)),
        (kalman, "sigma_m", (0.0, INF)),
        (kalman, "sigma_a_m_s2", (-1.0, INF)),
        (kalman, "p_detect", (-0.1, 1.1, NAN)),
        (kalman, "clutter_per_m2", (0.0, -1.0)),
        (kalman, "birth_sigma_m_s", (0.0, NAN)),
        (kalman, "birth_sigma_m", (-1.0, INF)),
        (kalman, "gate", (0.0, NAN)),
        (kalman, "echoes", (0.0, INF)),
        (lifecycle, "confirm_hits", (0, 6)),
        (lifecycle, "delete_misses", (0,)),
        (lifecycle, "delete_tentative_misses", (0,)),
        (echoes, "p_detect", (-0.1, 1.1, NAN)),
        (echoes, "echoes", (0.5, NAN, INF)),
        (echoes, "spread_m", (-1.0, INF)),
        (echoes, "clutter_per_m2", (-1.0, NAN)),
    )
    for value in values
]


@pytest.mark.parametrize(("call", "name", "value"), CASES)
def test_a_value_that_cannot_be_is_named(call, name, value):
    with pytest.raises(ValueError, match=rf"\b{name}: got {value}, want"):
        call(**{name: value})


WINDOWS = (improved, neutrosophic, soft, standard, joint, clustering, initiate)


@pytest.mark.parametrize("call", [improved, neutrosophic, joint, initiate])
@pytest.mark.parametrize(
    ("speed", "name"),
    [((-1.0, 5.0), "v_min_m_s"), ((NAN, 5.0), "v_min_m_s"), ((5.0, 5.0), "v_max_m_s")],
)
def test_speeds_that_are_no_range_are_named(call, speed, name):
    speed = hough.SpeedGate(*speed)
    with pytest.raises(ValueError, match=rf"speed\.{name}: got {getattr(speed, name)}, want"):
        call(speed=speed)


@pytest.mark.parametrize("call", [improved, neutrosophic, standard])
def test_grids_and_extractors_that_cannot_be_are_named(call):
    for peaks in ({"separation_rho_m": -1.0}, {"member_m": NAN}, {"gate": NAN}):
        ((name, _),) = peaks.items()
        with pytest.raises(ValueError, match=f"peaks.{name}: got"):
            call(peaks=hough.Peaks(**peaks))
    with pytest.raises(ValueError, match=r"grid.rho_max_m: got"):
        call(grid=hough.Grid(rho_max_m=0.0))


@pytest.mark.parametrize("call", WINDOWS)
@pytest.mark.parametrize(
    ("field", "value"),
    [
        ("position_m", GOOD.position_m.at[1, 1].set(INF)),
        ("time_s", GOOD.time_s[::-1]),
        ("mask", jnp.ones((3, 2))),
    ],
)
def test_looks_with_broken_values_are_named(call, field, value, monkeypatch):
    monkeypatch.setitem(globals(), "GOOD", GOOD._replace(**{field: value}))
    with pytest.raises((TypeError, ValueError), match=rf"scans.{field}: got"):
        call()


@pytest.mark.parametrize("field", ["mask", "valid"])
def test_a_mask_of_numbers_is_named_by_the_kalman_tracker(field):
    tracker = kalman()
    look = jax.tree.map(lambda x: x[0], GOOD)
    look = look._replace(**{field: getattr(look, field).astype(float)})
    with pytest.raises(TypeError, match=rf"scan.{field}: got dtype float64, want booleans"):
        tracker.step(tracker.init(jax.random.key(0)), look)


@pytest.mark.parametrize(
    ("field", "value"),
    [
        ("range_m", LOUD.range_m.at[1, 1].set(NAN)),
        ("time_s", LOUD.time_s[::-1]),
        ("mask", LOUD.mask[:2]),
        ("mask", jnp.ones((3, 4))),
        ("valid", jnp.ones(3, int)),
        ("pose.heading_rad", jnp.zeros(2)),
    ],
)
def test_beams_with_broken_values_are_named(field, value, monkeypatch):
    first, _, second = field.partition(".")
    value = LOUD.pose._replace(**{second: value}) if second else value
    monkeypatch.setitem(globals(), "LOUD", LOUD._replace(**{first: value}))
    with pytest.raises((TypeError, ValueError), match=rf"scans.{field}: got"):
        beams()


@pytest.mark.parametrize(
    ("looks", "sensor", "observation", "message"),
    [
        (GOOD, BeamSensor(), BEAMS, "scans: got a Scan, .* want a BeamScan"),
        (LOUD, SENSOR, POSITION, "scans: got a BeamScan, want a Scan"),
        (LOUD, SENSOR, BEAMS, "sensor: got a PositionSensor, want a BeamSensor"),
        (GOOD, BeamSensor(), POSITION, "sensor: got a BeamSensor, want a PositionSensor"),
    ],
)
def test_looks_and_sensors_of_another_kind_are_named(looks, sensor, observation, message):
    params = hough.joint.JointParams(sensor)
    with pytest.raises(TypeError, match=message):
        hough.joint.estimate(looks, params, sizes=JOINT, observation=observation)


def test_beams_are_no_positions(monkeypatch):
    monkeypatch.setitem(globals(), "GOOD", LOUD)
    for call in (clustering, standard, improved):
        with pytest.raises(TypeError, match="scans: got a BeamScan, want a Scan"):
            call()


def test_weights_below_zero_and_no_samples_are_named():
    samples, weights = jnp.ones((3, 2)), jnp.array([1.0, -1.0, 1.0])
    with pytest.raises(ValueError, match=r"weights: got .* want numbers of at least 0"):
        fuzzy_cmeans(samples, weights, samples[:1])
    hidden = weights >= 0  # what is masked may be anything
    assert fuzzy_cmeans(samples, weights, samples[:1], mask=hidden).objective == 0.0
    with pytest.raises(ValueError, match="number of samples: got 0"):
        farthest_first(samples[:0], weights[:0], mask=hidden[:0], clusters=2)
