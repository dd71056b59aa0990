"""Each soft part tends to its hard twin as its temperature goes to zero.

A new soft part joins by a line in `PARTS`, a whole estimator by one in `ESTIMATORS`. Parts are
looked at away from the edges where the hard ones jump: there no temperature brings them together.
"""

import functools

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from jaxtrack import clustering, hough, moments, sensors, tracking, tuning
from jaxtrack.association import (
    AssociationParams,
    belief_propagation,
    jpda,
    nearest,
    pmht,
    predict_measurement,
    sinkhorn,
)
from jaxtrack.association import cloud as echoes
from jaxtrack.clustering import cloud
from jaxtrack.filtering import resampling
from jaxtrack.hough import line_cells, slope_intercept, standard
from jaxtrack.hough.votes import Votes, accumulate, evaluate, hard, soft
from jaxtrack.numerics.choice import choose, greater, step
from jaxtrack.tracking import lifecycle, soft_lifecycle
from jaxtrack.tracking.lifecycle import Births
from jaxtrack.types import Scan, Stage
from tests.hough import test_clustering_statistic as csht
from tests.hough.cases import GRID, PEAKS, SIZES, SPEED, random_looks

FLOAT = jnp.dtype(np.float64)


def draw(seed, *shape, low=-1.0, high=1.0):
    return jnp.asarray(np.random.default_rng(seed).uniform(low, high, shape))


X, Y = draw(0, 8), draw(1, 8)
VALUE, ALLOWED = draw(2, 4, 5, low=0.0), jnp.asarray(np.random.default_rng(3).random((4, 5)) < 0.8)
POINTS, WEIGHTS = draw(4, 30, 2), draw(5, 30, low=0.5)
DISC = {"radius": 0.9}


def chosen(temperature):
    pick, left = choose(VALUE, ALLOWED, temperature)
    return pick(VALUE), left


def faded(temperature):
    """Return the weights of detections of a target that is not seen from 2.3 s to 4.9 s."""
    looks = Scan(jnp.arange(8.0), jnp.ones(8, bool), jnp.zeros((8, 1, 2)), jnp.ones((8, 1), bool))
    gap = sensors.Fade(jnp.array([3.6]), jnp.array([2.6]), temperature)
    return sensors.fade(looks, jnp.zeros((8, 1), jnp.int32), gap)


CELLS = hough.Sizes(rho=20, theta=12)
RHO = jnp.asarray(np.array([3.3, 3.6, 9.5, 12.4]) * 35.0 - 350.0)
THETA = jnp.asarray(np.array([2.4, 2.7, 5.3, 9.5]) * np.pi / 12)
VOTES = Votes(RHO, THETA, jnp.array([1.0, 0.5, 2.0, 1.5]), jnp.ones(4, bool))
FIELD = hough.Grid((0.0, 0.0), 350.0)


def votes_softly(temperature):
    kernel = soft(FIELD, CELLS, 20.0 * temperature, 0.1 * temperature, FLOAT)
    return evaluate(RHO, THETA, VOTES, kernel)


SCATTERED = Scan(
    jnp.arange(3.0), jnp.ones(3, bool), 150.0 * draw(17, 3, 2, 2), jnp.ones((3, 2), bool)
)
CENTRES_AT = jnp.meshgrid(
    35.0 * (jnp.arange(20.0) + 0.5) - 350.0, (jnp.arange(12.0) + 0.5) * jnp.pi / 12
)


def sinusoids_softly(temperature):
    """Return the soft votes of detections in all cells, as their accumulator stands."""
    rho, theta = (x.ravel() for x in CENTRES_AT)
    eps = 20.0 * temperature, 0.1 * temperature
    return standard.soft_votes(rho, theta, SCATTERED, FIELD, *eps, sizes=CELLS).reshape(12, 20)


CLUSTERED = draw(18, 6, 7, low=0.0)
PATCH, PATCH_SIZES = slope_intercept.LineGrid(-3.0, 1.0, 0.0, 2.0), slope_intercept.LineSizes(6, 7)


def strong_cells(temperature):
    found = line_cells.cells_above(
        CLUSTERED, 0.6, PATCH, cells=30, sizes=PATCH_SIZES, temperature=temperature
    )
    return found.votes


def one_line(temperature):
    return line_cells.single_line(CLUSTERED, 0.6, PATCH, sizes=PATCH_SIZES, temperature=temperature)


PARTICLES, LOG_WEIGHT = draw(19, 12, 2), 2.0 * draw(20, 12)


def resampled(resampler):
    found = resampler(jax.random.key(5), PARTICLES, LOG_WEIGHT)
    return found.particles, jnp.exp(found.log_weight)


LINE_GRID = slope_intercept.LineGrid(-2.0, 2.0, -10.0, 6.0)
LINE_SIZES = slope_intercept.LineSizes(velocities=5, positions=8, fine=64)
PLACES = slope_intercept.Points(
    jnp.zeros((3, 2)),
    jnp.asarray(6.0 * np.array([[0, 3], [2, 2], [5, 1]]) - 10.0 + 3.0) + draw(6, 3, 2),
    jnp.ones((3, 2)),
)

SAMPLES = jnp.concatenate([draw(7, 10, 2) * 0.5, draw(8, 10, 2) * 0.5 + 0.8])
CENTRES = jnp.array([[0.1, 0.0], [0.7, 0.9]])
CLOUD = {
    "centres": CENTRES,
    "floor": jnp.full((20, 2), 0.3),
    "allowed": jnp.ones((2, 20), bool),
}
NEAR = -((SAMPLES[None, :] - CENTRES[:, None]) ** 2).sum(-1)


def classes(temperature):
    found = cloud.cloud_cmeans(SAMPLES, jnp.ones(20), NEAR, temperature=temperature, **CLOUD)
    return found.members, found.cloud.expectation


def crisp():
    squared = ((SAMPLES[:, None] - CENTRES[None, :]) ** 2).sum(-1)
    return jax.nn.one_hot(squared.argmin(1), 2).T


def looks_for_association():
    """Return three predicted tracks of one covariance, and five detections, one of them alone."""
    mean = jnp.array([[0.0, 0.0, 1.0, 0.0], [2.2, 0.3, 1.0, 0.0], [9.0, 0.0, 1.0, 0.0]])
    at = jnp.array([[0.9, 0.2], [1.3, -0.6], [2.9, 0.8], [9.3, -0.6], [30.0, 30.0]])
    return mean, Scan(jnp.array(0.0), jnp.array(True), at, jnp.ones(5, bool))


GATE, SPREAD = 9.0, 0.8


def shared_by_clouds(associate):
    mean, scan = looks_for_association()
    predicted = predict_measurement(mean, jnp.zeros((3, 4, 4)), SPREAD**2 * jnp.eye(2))
    return associate(predicted, scan, AssociationParams(0.5, 1e-3, GATE)).weight


def associated(associate, temperature):
    """Associate with all densities to the power of 1 / T, but for one factor.

    Covariances shrink with T, and clutter is as dense as a track is at the gate's edge: so where a
    track or clutter is likelier does not change, only how much likelier it is.
    """
    mean, scan = looks_for_association()
    noise = temperature * SPREAD**2 * jnp.eye(2)
    predicted = predict_measurement(mean, 0.0 * jnp.eye(4)[None] + jnp.zeros((3, 4, 4)), noise)
    edge = jnp.exp(-GATE / (2 * temperature)) / (2 * jnp.pi * temperature * SPREAD**2)
    params = AssociationParams(0.5, edge, GATE / temperature)
    return associate(predicted, scan, params).weight


def nearest_track():
    """Return each detection given to the track nearest to it, if that is in its gate."""
    mean, scan = looks_for_association()
    squared = ((scan.position_m[None] - mean[:, None, :2]) ** 2).sum(-1) / SPREAD**2
    mine = jnp.arange(3)[:, None] == squared.argmin(0)[None, :]
    return (mine & (squared < GATE)).astype(float)


LIVES = tracking.LifecycleParams(2, 1.0, 3, 2, 6)
HITS = jnp.asarray(np.random.default_rng(11).random((12, 6)) < 0.5)
LEVELS = 1.0 + draw(12, 12, 6) + jnp.sign(draw(12, 12, 6))  # scores, clear of that which confirms
BORN = Births(jnp.zeros((6, 2)), jnp.zeros((6, 2, 2)), jnp.ones(6, bool), jnp.zeros(6))


def lives(temperature):
    """Return by how much six tracks exist after each of twelve looks; None: whether they do."""
    seen, look = jnp.ones(6, bool), jnp.asarray(True)

    def softly(soft, now):
        hit, score = now
        tracks = soft.table.tracks._replace(log_score=score)
        soft = soft._replace(table=soft.table._replace(tracks=tracks))
        soft = soft_lifecycle.soft_grade(soft, hit.astype(float), seen, look, LIVES, softness)
        return soft, soft.table.tracks.existence

    def hardly(table, now):
        hit, score = now
        table = table._replace(tracks=table.tracks._replace(log_score=score))
        table = lifecycle.grade(table, hit, seen, look, LIVES)
        return table, (table.tracks.stage >= Stage.CONFIRMED).astype(float)

    size = {"tracks": 6, "state": 2, "looks": 4}
    if temperature is None:
        begin = lifecycle.admit(lifecycle.empty_table(jnp.zeros(()), **size), BORN, LIVES).table
        return jax.lax.scan(hardly, begin, (HITS, LEVELS))[1]
    softness = soft_lifecycle.Softness(looks=0.5 * temperature, score=0.5 * temperature)
    begin = soft_lifecycle.soft_empty_table(jnp.zeros(()), **size)
    begin, _ = soft_lifecycle.soft_admit(begin, BORN, jnp.ones(6), LIVES)
    return jax.lax.scan(softly, begin, (HITS, LEVELS))[1]


PATTERNS = jnp.array([[0.0, 0.0], [6.0, 0.0], [6.0, 5.0], [3.0, 3.0]])
SPOTS = jnp.repeat(PATTERNS, jnp.array([9, 8, 2, 5]), axis=0, total_repeat_length=24)
SPOTS = SPOTS + draw(13, 24, 2) * jnp.where(jnp.arange(24) < 19, 0.6, 3.0)[:, None]
FOUR, ONES = jnp.ones(4, bool), jnp.ones(24)
MEMBERS = clustering.memberships(SPOTS, PATTERNS, active=FOUR, fuzzifier=1.6)
# None is near enough to another to fall to it: what is left of survival is deletion.
DELETION = clustering.IsodataParams(
    merge_exponent=0.0, membership_floor=0.5, aggregation_gate=0.8, delete_share=0.7
)


def deleted():
    found = clustering.partition(SPOTS, ONES, PATTERNS, FOUR, MEMBERS, params=DELETION)
    return clustering.delete(FOUR, ONES.sum(), found, params=DELETION).astype(float)


SCORE = {"cutoff": 1.0, "order": 2.0}
SETS = (draw(9, 3, 2), jnp.ones(3, bool), draw(10, 4, 2), jnp.ones(4, bool))
TABLE = {"votes": jnp.array([9.0, 4.0, 2.0, 1.0]), "mask": jnp.ones(4, bool), "false_per_run": 0.4}
NEAR_ONE = jnp.array([[True, False], [False, False], [False, True], [False, False]])


def shortfall(temperature):
    votes, mask = TABLE["votes"], TABLE["mask"]
    return temperature * tuning.candidate_softmax(votes, mask, NEAR_ONE, temperature=temperature)


# name: (soft(temperature), hard(), temperatures, the last one's largest error)
WARM = (0.5, 0.1, 0.02, 1e-3)
COOL = (0.1, 0.02, 1e-3, 1e-4)  # of those that, warmer, are beside the point altogether
PARTS = {
    "step": (lambda t: step(X, t), lambda: step(X, None), WARM, 1e-6),
    "greater": (lambda t: greater(X, Y, t), lambda: greater(X, Y, None), WARM, 1e-6),
    "choose": (chosen, lambda: chosen(None), WARM, 1e-6),
    "detection weights": (
        lambda t: faded(t).weight[:, 0],
        lambda: sensors.drop(jax.random.key(0), faded(1e-9)).mask[:, 0].astype(float),
        WARM,
        1e-6,
    ),
    "votes": (
        votes_softly,
        lambda: evaluate(RHO, THETA, VOTES, hard(FIELD, CELLS, FLOAT)),
        WARM,
        1e-6,
    ),
    "votes of detections": (
        sinusoids_softly,
        lambda: standard.accumulator(SCATTERED, FIELD, sizes=CELLS),
        WARM,
        1e-6,
    ),
    "strong cells": (strong_cells, lambda: strong_cells(None), COOL, 1e-6),
    "one line": (one_line, lambda: one_line(None), COOL, 1e-6),
    # Here the temperature is the share of equal weights in what is drawn from.
    "resampling": (
        lambda t: resampled(resampling.soft(resampling.systematic, 1 - t)),
        lambda: resampled(resampling.systematic),
        WARM,
        1e-2,
    ),
    "votes of lines over time": (
        lambda t: slope_intercept.soft_votes(PLACES, LINE_GRID, 4.0 * t, sizes=LINE_SIZES),
        lambda: slope_intercept.hard_votes(PLACES, LINE_GRID, sizes=LINE_SIZES),
        (0.5, 0.1, 0.02),
        1e-6,
    ),
    "memberships": (
        lambda t: clustering.memberships(
            SAMPLES, CENTRES, fuzzifier=1.0 + t, active=jnp.ones(2, bool)
        ),
        crisp,
        (0.5, 0.1, 0.02),
        1e-6,
    ),
    "clouds": (classes, lambda: classes(None), WARM, 1e-6),
    "patterns": (
        lambda t: clustering.survival(
            SPOTS, ONES, PATTERNS, FOUR, MEMBERS, 0.2 * t, params=DELETION
        ),
        deleted,
        WARM,
        1e-6,
    ),
    "JPDA": (
        functools.partial(associated, jpda.associate),
        lambda: associated(nearest.optimal, 1.0),
        (0.5, 0.1, 0.02),
        1e-6,
    ),
    "belief propagation": (
        functools.partial(associated, belief_propagation.associate),
        lambda: associated(nearest.optimal, 1.0),
        (0.5, 0.1, 0.02),
        1e-6,
    ),
    "clouds of echoes": (
        lambda t: shared_by_clouds(functools.partial(echoes.soft, temperature=t)),
        lambda: shared_by_clouds(echoes.averaged),
        COOL,
        1e-6,
    ),
    "association by scaling": (
        functools.partial(associated, sinkhorn.associate),
        lambda: associated(nearest.optimal, 1.0),
        (0.5, 0.1, 0.02),
        1e-6,
    ),
    "PMHT": (functools.partial(associated, pmht.associate), nearest_track, (0.5, 0.1, 0.02), 1e-6),
    "smooth OSPA": (
        lambda t: tuning.sinkhorn_ospa(*SETS, **SCORE, temperature=t, iterations=3000).distance,
        lambda: tuning.ospa(*SETS, **SCORE).distance,
        WARM,
        1e-2,
    ),
    "smooth GOSPA": (
        lambda t: tuning.sinkhorn_gospa(*SETS, **SCORE, temperature=t, iterations=3000).distance,
        lambda: tuning.gospa(*SETS, **SCORE).distance,
        WARM,
        1e-2,
    ),
    "windows": (
        lambda t: moments.soft_inside(POINTS, WEIGHTS, taper=t, **DISC)[1],
        lambda: moments.inside(POINTS, WEIGHTS, **DISC)[1],
        WARM,
        1e-6,
    ),
    "moments": (
        lambda t: jnp.abs(
            moments.soft_zernike(POINTS, WEIGHTS, orders=moments.LOW_ORDERS, taper=t, **DISC)
        ),
        lambda: jnp.abs(moments.zernike(POINTS, WEIGHTS, orders=moments.LOW_ORDERS, **DISC)),
        WARM,
        1e-6,
    ),
    "features": (
        lambda t: moments.soft_log_features(VALUE, t**2),
        lambda: -moments.log_features(VALUE),
        WARM,
        1e-3,
    ),
    "lives": (lives, lambda: lives(None), WARM, 1e-6),
    "gates": (
        lambda t: tuning.false_track_loss(3.0, temperature=t, **TABLE),
        lambda: tuning.false_track_loss(3.0, **TABLE),
        WARM,
        1e-6,
    ),
    # The best of a target's own, 9 and 2, against the best false one, 4.
    "candidates": (shortfall, lambda: jnp.array((0.0 + 2.0) / 2), WARM, 1e-2),
}


@pytest.mark.parametrize("name", PARTS)
def test_a_soft_part_tends_to_its_hard_twin(name):
    softly, hardly, temperatures, tolerance = PARTS[name]
    expected = jax.tree.leaves(hardly())
    run = jax.jit(softly)
    errors = []
    for temperature in temperatures:
        got = jax.tree.leaves(run(jnp.asarray(temperature)))
        errors.append(max(np.abs(a - b).max() for a, b in zip(got, expected, strict=True)))
    assert errors[0] > 1e-3, "at the warmest they are to differ"
    assert (np.diff(errors) <= 1e-12).all()
    assert errors[-1] <= tolerance, errors


def test_the_best_votes_are_those_of_a_cell_of_the_accumulator():
    """The hard twin of soft votes, counted another way."""
    table = accumulate(VOTES, FIELD, sizes=CELLS)
    assert float(table.max()) == float(votes_softly(1e-3).max()) == 2.0


# name: (soft(looks, temperature), hard(looks))
RAW = SIZES._replace(smooth=0)
NEUTROSOPHIC = hough.neutrosophic.NeutrosophicParams(GRID, PEAKS, SPEED, 20.0, 0.15)
IMPROVED = hough.improved.ImprovedParams(GRID, PEAKS, SPEED)
MODIFIED = hough.modified.ModifiedParams(GRID, PEAKS)
ESTIMATORS = {
    "modified": (
        lambda looks, t: hough.modified.soft_estimate(looks, MODIFIED, 20 * t, 0.1 * t, sizes=RAW),
        lambda looks: hough.modified.estimate(looks, MODIFIED, sizes=RAW),
    ),
    "improved": (
        lambda looks, t: hough.improved.soft_estimate(looks, IMPROVED, 20 * t, 0.1 * t, sizes=RAW),
        lambda looks: hough.improved.estimate(looks, IMPROVED, sizes=RAW),
    ),
    "neutrosophic": (
        lambda looks, t: hough.neutrosophic.soft_estimate(looks, NEUTROSOPHIC, t, sizes=RAW),
        lambda looks: hough.neutrosophic.estimate(looks, NEUTROSOPHIC, sizes=RAW),
    ),
}


@pytest.mark.slow  # what each compiles is tested part by part beside it
@pytest.mark.parametrize("name", ESTIMATORS)
def test_the_lines_found_agree(name):
    softly, hardly = (jax.jit(method) for method in ESTIMATORS[name])
    for seed in range(4):
        looks = random_looks(np.random.default_rng(seed), 4, 5)
        expected, got = hardly(looks)[0], softly(looks, 1e-7)[0]
        assert expected.mask.any()
        np.testing.assert_array_equal(got.mask, expected.mask)
        np.testing.assert_allclose(got.votes, expected.votes, rtol=1e-6)
        np.testing.assert_allclose(got.rho_m, expected.rho_m, atol=1e-3)
        np.testing.assert_allclose(got.theta_rad, expected.theta_rad, atol=1e-5)


def two_targets():
    """Return looks at two targets and clutter; of the first nothing is seen from look 9 to 11."""
    rng = np.random.default_rng(0)
    time_s = np.arange(24.0)
    start, velocity = np.array([[0.0, 0.0], [0.0, 12.0]]), np.array([[1.2, 0.1], [1.2, -0.3]])
    at = start + time_s[:, None, None] * velocity + 0.3 * rng.normal(size=(24, 2, 2))
    false = rng.uniform(-5.0, 35.0, (24, 2, 2))
    scans = Scan(*map(jnp.asarray, (time_s, np.ones(24, bool), np.concatenate([at, false], 1),
                                    rng.random((24, 4)) < [1.0, 1.0, 0.4, 0.4])))  # fmt: skip
    return scans, jnp.asarray(np.tile([0, 1, -1, -1], (24, 1)))


TRACKER = tracking.KalmanTrackerParams(0.3, 0.1, 0.9, 1e-3, birth_sigma_m_s=1.5)


@functools.cache
def tracker(name, softness=None):
    lives = None if softness is None else tracking.soft_lives(tracking.Softness(*softness))

    def run(scans):
        made = tracking.kalman_tracker(TRACKER, max_tracks=8, associator=name, lives=lives)
        return jax.lax.scan(made.step, made.init(jax.random.key(0)), scans)[1].tracks

    return jax.jit(run)


def confirmed(tracks):
    return np.asarray(tracks.mask & (tracks.stage >= Stage.CONFIRMED))


def test_tracks_of_weighed_detections_tend_to_those_of_dropped_ones():
    scans, origin = two_targets()
    gap = lambda edge: sensors.fade(
        scans, origin, sensors.Fade(jnp.array([10.0, 0.0]), jnp.array([3.2, 0.0]), edge)
    )
    expected = tracker("jpda")(sensors.drop(jax.random.key(0), gap(1e-9)))
    assert confirmed(expected).any(1)[3:].all()
    apart = []
    for edge in (0.1, 0.03, 1e-3):
        got = tracker("jpda")(gap(edge)._replace(weight=gap(edge).weight))
        np.testing.assert_array_equal(confirmed(got), confirmed(expected))
        apart.append(np.abs(np.where(confirmed(got)[..., None], got.mean - expected.mean, 0)).max())
    assert apart[0] > apart[1] >= apart[2]
    assert apart[2] < 1e-6


@pytest.mark.slow
@pytest.mark.parametrize("name", ["jpda", "pmht", "belief_propagation", "cloud_averaged"])
def test_tracks_with_soft_lives_are_those_with_hard_ones(name):
    scans, _ = two_targets()
    expected = tracker(name)(scans)
    assert confirmed(expected)[-1].sum() >= 2
    got = tracker(name, (1e-6,) * 4)(scans)
    np.testing.assert_array_equal(got.stage, expected.stage)
    np.testing.assert_array_equal(got.identity, expected.identity)
    np.testing.assert_allclose(got.mean, expected.mean, rtol=1e-9, atol=1e-9)
    np.testing.assert_allclose(got.existence, confirmed(expected), atol=1e-6)


@pytest.mark.slow
def test_targets_of_the_soft_clustering_statistic_are_those_of_the_hard_one():
    """In most windows: a vote on the edge of a cell may decide on the number of clusters."""
    fine = csht.SIZES._replace(lines=csht.SIZES.lines._replace(fine=64))
    exact = jax.jit(functools.partial(hough.clustering_statistic.soft_estimate, sizes=fine))
    same = 0
    for seed in range(8):
        looks = csht.looks(seed)
        hard, _ = csht.run(looks, csht.PARAMS)
        soft, _ = exact(looks, csht.PARAMS, 0.01, 1e-4)
        if (soft.mask == hard.mask).all():
            same += bool((np.abs(soft.mean - hard.mean) < [[1.0, 1.0, 0.2, 0.2]]).all())
    assert same >= 4


def test_tracks_of_a_soft_association_agree_with_a_hard_one_s_where_nothing_is_in_doubt():
    scans, _ = two_targets()
    alone = scans._replace(mask=scans.mask.at[:, 2:].set(False))
    expected = tracker("optimal")(alone)
    got = tracker("jpda")(alone)
    np.testing.assert_array_equal(confirmed(got), confirmed(expected))
    assert confirmed(expected)[-1].sum() == 2
    far = np.abs(got.mean - expected.mean)[..., :2]
    # A miss keeps about 1 / (1 + P_D N / β) of the weight, less than a hundredth.
    assert np.where(confirmed(got)[..., None], far, 0.0).max() < 0.1
