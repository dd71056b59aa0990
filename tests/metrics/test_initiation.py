"""Scores of track initiation: hand-computed scenes, plain loops, gradients."""

import functools

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from jaxtrack.metrics import (
    MAX_DISCRIMINATION,
    decline,
    divergence,
    initiation_scores,
    least_squares_line,
    line_distance,
)
from jaxtrack.types import Lines
from tests.metrics.differences import assert_gradients_agree
from tests.oracles import initiation as oracle

SHAPES = ((1, 1, 2), (5, 3, 4), (8, 2, 6))  # M, K, T
few = settings(max_examples=60, deadline=None, derandomize=True, database=None)

# Three targets of three looks: y = 40 m, x = 100 m, and the diagonal y = x.
TARGETS = np.array(
    [
        [[0.0, 40.0], [50.0, 40.0], [100.0, 40.0]],
        [[100.0, -50.0], [100.0, 0.0], [100.0, 50.0]],
        [[-10.0, -10.0], [0.0, 0.0], [10.0, 10.0]],
    ]
)
FIRST, SECOND, THIRD = (40.0, np.pi / 2), (100.0, 0.0), (0.0, 3 * np.pi / 4)
FAR = (-300.0, 1.0)


def make_lines(*rows, dtype=float):
    rho_m, theta_rad, votes = np.array(rows, dtype).T
    return Lines(*map(jnp.asarray, (rho_m, theta_rad, votes)), mask=jnp.ones(len(rows), bool))


@functools.cache
def jitted():
    return jax.jit(
        lambda lines, position_m, mask, match_m, gate: initiation_scores(
            lines, position_m, mask, match_m=match_m, gate=gate
        )
    )


def score(lines, targets=TARGETS, mask=None, match_m=5.0, gate=3.0):
    mask = np.ones(len(targets), bool) if mask is None else np.asarray(mask)
    return jitted()(lines, jnp.asarray(targets, lines.rho_m.dtype), mask, match_m, gate)


def test_one_of_everything():
    # The second target's line is written with θ + π: it is 1 m short and turned by −0.01 rad.
    scores = score(
        make_lines(
            (41.0, np.pi / 2, 9.0),  # finds the first target
            (38.0, np.pi / 2, 5.0),  # finds it again
            (-99.0, np.pi - 0.01, 7.0),  # finds the second
            (0.0, 3 * np.pi / 4, 2.0),  # on the third, but below the gate
            (-300.0, 1.0, 6.0),  # false
            (-400.0, 1.0, 1.0),  # false, below the gate
        )
    )
    assert (int(scores.found), int(scores.false), int(scores.redundant)) == (2, 1, 1)
    assert not bool(scores.perfect)
    assert not bool(scores.top_k)
    np.testing.assert_array_equal(scores.found_mask, [True, True, False])
    np.testing.assert_allclose(scores.rho_error_m, [1.0, -1.0, 0.0], atol=1e-12)
    np.testing.assert_allclose(scores.theta_error_rad, [0.0, -0.01, 0.0], atol=1e-12)
    assert float(scores.weakest_true_votes) == 2.0
    assert float(scores.strongest_false_votes) == 6.0
    assert float(scores.discrimination) == pytest.approx(1 / 3)


def test_perfect():
    scores = score(make_lines((*THIRD, 4.0), (*FIRST, 9.0), (*SECOND, 3.0)))
    assert int(scores.found) == 3
    assert bool(scores.perfect)
    assert bool(scores.top_k)
    np.testing.assert_allclose(scores.rho_error_m, 0.0, atol=1e-12)
    assert float(scores.discrimination) == pytest.approx(MAX_DISCRIMINATION)


def test_own_line_is_the_strongest_then_the_nearest():
    strongest = score(make_lines((40.1, np.pi / 2, 4.0), (43.0, np.pi / 2, 5.0)), TARGETS[:1])
    np.testing.assert_allclose(strongest.rho_error_m, [3.0])
    nearest = score(make_lines((43.0, np.pi / 2, 5.0), (39.0, np.pi / 2, 5.0)), TARGETS[:1])
    np.testing.assert_allclose(nearest.rho_error_m, [-1.0])


def test_a_line_matches_only_its_nearest_target():
    close = np.array([[[0.0, 40.0], [9.0, 40.0]], [[0.0, 43.0], [9.0, 43.0]]])
    scores = score(make_lines((41.0, np.pi / 2, 9.0), (42.0, np.pi / 2, 1.0)), close)
    np.testing.assert_array_equal(scores.found_mask, [True, False])


@pytest.mark.parametrize(
    ("rows", "expected"),
    [
        ([(*FIRST, 2.0), (*SECOND, 1.0), (*THIRD, 1.5), (*FAR, 0.5)], True),  # no gate
        ([(*FIRST, 9.0), (*SECOND, 8.0), (*THIRD, 6.0), (*FAR, 7.0)], False),  # one is false
        ([(*FIRST, 9.0), (*SECOND, 8.0), (*THIRD, 6.0), (*FIRST, 7.0)], False),  # one is twice
        ([(*FIRST, 9.0), (*SECOND, 8.0), (*THIRD, 6.0), (*FAR, 6.0)], False),  # a tie
        ([(*FIRST, 9.0), (*SECOND, 8.0)], False),  # too few
    ],
)
def test_top_k(rows, expected):
    assert bool(score(make_lines(*rows)).top_k) is expected


@pytest.mark.parametrize(("rho_m", "found"), [(44.999, 1), (45.001, 0)])
def test_matches_within_the_distance_only(rho_m, found):
    scores = score(make_lines((rho_m, np.pi / 2, 4.0)), TARGETS[:1])
    assert (int(scores.found), int(scores.false)) == (found, 1 - found)


def test_the_gate_itself_is_above_the_gate():
    assert int(score(make_lines((*FIRST, 3.0)), TARGETS[:1], gate=3.0).found) == 1
    assert int(score(make_lines((*FIRST, 3.0)), TARGETS[:1], gate=3.5).found) == 0


def test_clutter_alone():
    lines = make_lines((*FIRST, 9.0), (*FAR, 2.0))
    scores = score(lines, np.full((1, 3, 2), np.nan), mask=[False])
    assert (int(scores.found), int(scores.false), int(scores.redundant)) == (0, 1, 0)
    assert not bool(scores.perfect)
    assert bool(scores.top_k)
    assert float(scores.strongest_false_votes) == 9.0
    assert float(scores.discrimination) == 0.0


def test_no_lines():
    lines = Lines(*(jnp.full(2, jnp.nan) for _ in range(3)), mask=jnp.zeros(2, bool))
    scores = score(lines)
    assert (int(scores.found), int(scores.false), int(scores.redundant)) == (0, 0, 0)
    assert not bool(scores.perfect)
    assert not bool(scores.top_k)
    assert float(scores.discrimination) == 0.0
    assert all(np.all(np.isfinite(leaf)) for leaf in scores)


@st.composite
def scenes(draw):
    """Straight targets, lines on and off them in either writing, few distinct votes, NaNs."""
    rows, targets, looks = draw(st.sampled_from(SHAPES))
    rng = np.random.default_rng(draw(st.integers(0, 2**32 - 1)))
    exists = np.array(draw(st.lists(st.booleans(), min_size=rows, max_size=rows)))
    present = np.array(draw(st.lists(st.booleans(), min_size=targets, max_size=targets)))

    start_m = rng.uniform(-50.0, 50.0, (targets, 1, 2))
    step_m = rng.uniform(5.0, 20.0, (targets, 1, 2)) * rng.choice([-1.0, 1.0], (targets, 1, 2))
    position_m = start_m + step_m * np.arange(looks)[None, :, None]
    position_m += rng.normal(scale=0.5, size=position_m.shape)

    on_target = np.array([oracle.fit_line(position_m[k]) for k in rng.integers(0, targets, rows)])
    rho_m, theta_rad = on_target.T + rng.normal(scale=[[2.0], [0.03]], size=(2, rows))
    astray = rng.random(rows) < 0.4
    rho_m = np.where(astray, rng.uniform(-80.0, 80.0, rows), rho_m)
    theta_rad = np.where(astray, rng.uniform(0.0, np.pi, rows), theta_rad)
    rho_m = np.where((theta_rad < 0) | (theta_rad >= np.pi), -rho_m, rho_m)
    theta_rad = np.mod(theta_rad, np.pi)
    votes = rng.integers(1, 5, rows).astype(float)

    lines = [np.where(exists, value, np.nan) for value in (rho_m, theta_rad, votes)]
    position_m = np.where(present[:, None, None], position_m, np.nan)
    return Lines(*lines, mask=exists), position_m, present


@few
@given(scenes(), st.sampled_from((2.0, 10.0, np.inf)), st.sampled_from((0.0, 2.5, 9.0)))
def test_equals_the_loops(scene, match_m, gate):
    lines, position_m, present = scene
    scores = jitted()(lines, position_m, present, match_m, gate)
    rows = [row[:3] for row in zip(*lines, strict=True) if row[3]]
    expected = oracle.initiation_scores(rows, list(position_m[present]), match_m, gate)
    errors = expected.pop("errors")
    for name, value in expected.items():
        assert getattr(scores, name) == value, name

    rho_error_m, theta_error_rad = np.zeros((2, len(present)))
    for target, place in enumerate(np.flatnonzero(present)):
        rho_error_m[place], theta_error_rad[place] = errors.get(target, (0.0, 0.0))
    np.testing.assert_allclose(scores.rho_error_m, rho_error_m, atol=1e-9)
    np.testing.assert_allclose(scores.theta_error_rad, theta_error_rad, atol=1e-10)
    assert set(np.flatnonzero(present)[list(errors)]) == set(np.flatnonzero(scores.found_mask))


@few
@given(scenes(), st.integers(0, 2**32 - 1))
def test_order_and_padding_change_nothing(scene, seed):
    lines, position_m, present = scene
    rng = np.random.default_rng(seed)
    rows, targets = rng.permutation(len(lines.mask)), rng.permutation(len(present))
    scores = jitted()(lines, position_m, present, 10.0, 2.0)
    shuffled = jitted()(
        Lines(*(field[rows] for field in lines)), position_m[targets], present[targets], 10.0, 2.0
    )
    longer = [np.append(field, [np.nan, np.nan]) for field in lines[:3]]
    padded = jitted()(
        Lines(*longer, mask=np.append(lines.mask, [False, False])), position_m, present, 10.0, 2.0
    )
    for name, value in scores._asdict().items():
        reordered = value[targets] if value.ndim else value
        np.testing.assert_allclose(getattr(shuffled, name), reordered, rtol=1e-12, atol=1e-12)
        np.testing.assert_allclose(getattr(padded, name), value, rtol=1e-12, atol=1e-12)


def test_vmap_equals_loop():
    rng = np.random.default_rng(2)
    lines = Lines(
        rho_m=jnp.asarray(rng.choice([40.0, 100.0, 0.0, 300.0], (6, 5))),
        theta_rad=jnp.asarray(rng.choice([np.pi / 2, 0.0, 3 * np.pi / 4], (6, 5))),
        votes=jnp.asarray(rng.uniform(1.0, 9.0, (6, 5))),
        mask=jnp.asarray(rng.random((6, 5)) < 0.8),
    )
    together = jax.vmap(lambda one: score(one))(lines)
    assert np.unique(together.found).size > 1
    for trial in range(6):
        alone = score(Lines(*(field[trial] for field in lines)))
        for name, value in alone._asdict().items():
            np.testing.assert_allclose(getattr(together, name)[trial], value, rtol=1e-13)


def test_float32():
    lines = make_lines((41.0, np.pi / 2, 9.0), (-99.0, np.pi - 0.01, 7.0), dtype=np.float32)
    scores = score(lines, gate=np.float32(3.0))
    assert {leaf.dtype for leaf in scores if leaf.dtype.kind == "f"} == {np.dtype("float32")}
    np.testing.assert_allclose(scores.rho_error_m, [1.0, -1.0, 0.0], atol=1e-4)
    np.testing.assert_allclose(scores.theta_error_rad, [0.0, -0.01, 0.0], atol=1e-6)


def test_integer_votes():
    lines = make_lines((*FIRST, 4.0), (*FAR, 2.0))._replace(votes=jnp.asarray([4, 2]))
    assert float(score(lines, TARGETS[:1]).discrimination) == 2.0


def test_gradients_of_the_scores_agree_with_central_differences():
    lines = make_lines((41.0, 1.58, 9.0), (-99.0, 3.13, 7.0), (0.5, 2.35, 4.0), (*FAR, 3.0))
    targets = TARGETS + np.random.default_rng(0).normal(scale=0.3, size=TARGETS.shape)

    def loss(rho_m, theta_rad, votes, position_m):
        moved = lines._replace(rho_m=rho_m, theta_rad=theta_rad, votes=votes)
        scores = initiation_scores(moved, position_m, jnp.ones(3, bool), match_m=9.0, gate=1.0)
        errors = jnp.sum(scores.rho_error_m**2) + jnp.sum(scores.theta_error_rad**2)
        return errors + scores.discrimination + 0.5 * scores.weakest_true_votes

    assert_gradients_agree(loss, *lines[:3], targets, atol=1e-7)


def test_gradients_are_finite_with_nan_behind_the_masks():
    def loss(values, position_m, exists, present):
        scores = initiation_scores(
            Lines(*values, mask=exists), position_m, present, match_m=5.0, gate=1.0
        )
        floats = (leaf for leaf in scores if jnp.issubdtype(leaf.dtype, jnp.floating))
        return sum(jnp.sum(leaf) for leaf in floats)

    gradient = jax.jit(jax.grad(loss, argnums=(0, 1)))
    # The second target rests, so that it has no line of its own.
    values = jnp.asarray(np.array([(*FIRST, 4.0), (*FAR, 2.0), (np.nan,) * 3]).T)
    targets = np.stack([TARGETS[0], np.full((3, 2), 7.0), np.full((3, 2), np.nan)])
    for exists in ([True, True, False], [True, False, False], [False, False, False]):
        for present in ([True, True, False], [False, True, False], [False, False, False]):
            leaves = gradient(values, jnp.asarray(targets), np.array(exists), np.array(present))
            assert all(np.all(np.isfinite(leaf)) for leaf in leaves)


def test_line_distance():
    lines = make_lines((*FIRST, 1.0), (43.0, np.pi / 2, 1.0))
    position_m = jnp.asarray([[[0.0, 41.0], [9.0, 47.0]]])  # 1 and 7 m, −2 and 4 m
    np.testing.assert_allclose(line_distance(lines, position_m), [[5.0], [np.sqrt(10.0)]])

    def loss(rho_m, theta_rad, position_m):
        moved = lines._replace(rho_m=rho_m, theta_rad=theta_rad)
        return jnp.sum(jnp.asarray([[1.0], [0.3]]) * line_distance(moved, position_m))

    assert_gradients_agree(loss, lines.rho_m, lines.theta_rad, position_m)


def test_line_distance_has_finite_gradients_on_the_line_and_behind_the_mask():
    lines = make_lines((*FIRST, 1.0), (np.nan, np.nan, np.nan))
    lines = lines._replace(mask=jnp.asarray([True, False]))

    def loss(rho_m, theta_rad):
        distance_m = line_distance(
            lines._replace(rho_m=rho_m, theta_rad=theta_rad), jnp.full((1, 2, 2), 40.0)
        )
        return jnp.sum(jnp.where(lines.mask[:, None], distance_m, 0.0))

    leaves = jax.jit(jax.grad(loss, argnums=(0, 1)))(lines.rho_m, lines.theta_rad)
    assert all(np.all(np.isfinite(leaf)) for leaf in leaves)


@few
@given(st.integers(0, 2**32 - 1))
def test_least_squares_line_equals_singular_value_decomposition(seed):
    rng = np.random.default_rng(seed)
    points_m = rng.normal(size=(5, 2)) @ rng.normal(size=(2, 2)) + rng.normal(size=2) * 10.0
    rho_m, theta_rad = jax.jit(least_squares_line)(points_m)
    assert 0.0 <= float(theta_rad) < np.pi
    expected = oracle.fit_line(points_m)
    difference = oracle.difference(float(rho_m), float(theta_rad), *expected)
    np.testing.assert_allclose(difference, 0.0, atol=1e-7)


def test_least_squares_line_gradient_agrees_with_central_differences():
    points_m = np.random.default_rng(4).normal(size=(5, 2)) + np.array([3.0, -7.0])

    def loss(points_m):
        rho_m, theta_rad = least_squares_line(points_m)
        return rho_m + 2.0 * theta_rad

    assert_gradients_agree(loss, points_m)


def test_divergence():
    # One vote three cells off in ρ, one four cells off in θ (in the other writing), weights 2 : 1.
    rho_m, theta_rad = (
        jnp.asarray([16.0, -10.0, jnp.nan]),
        jnp.asarray([0.01, np.pi - 0.03, jnp.nan]),
    )
    weight = jnp.asarray([2.0, 1.0, 0.0])
    value = jax.jit(divergence)(rho_m, theta_rad, weight, 10.0, 0.01, 2.0, 0.01)
    assert float(value) == pytest.approx(np.sqrt((2 * 3**2 + 4**2) / 3))
    assert float(divergence(rho_m, theta_rad, 0 * weight, 10.0, 0.01, 2.0, 0.01)) == 0.0


def test_divergence_gradient():
    rng = np.random.default_rng(6)
    rho_m, theta_rad, weight = rng.normal(50.0, 4.0, 5), rng.normal(0.0, 0.02, 5), rng.random(5)
    assert_gradients_agree(divergence, rho_m, theta_rad, weight, 50.0, 0.0, 5.0, 0.1, atol=1e-8)

    gradient = jax.jit(jax.grad(divergence, argnums=(0, 1, 2, 3, 4)))
    truth = (jnp.asarray(1.0), jnp.asarray(0.5), 2.0, 0.1)
    for weight in (jnp.zeros(2), jnp.ones(2)):  # no votes, and all of them on the spot
        leaves = gradient(jnp.ones(2), jnp.full(2, 0.5), weight, *truth)
        assert all(np.all(np.isfinite(leaf)) for leaf in leaves)


@pytest.mark.parametrize(
    ("peak", "expected", "value"), [(3.0, 4.0, 0.25), (5.0, 4.0, 0.0), (0, 4, 1.0), (2.0, 0.0, 0.0)]
)
def test_decline(peak, expected, value):
    assert float(jax.jit(decline)(peak, expected)) == value


def test_decline_gradient():
    assert_gradients_agree(lambda peak, expected: decline(peak, expected), 3.0, 4.0)


def test_errors_name_the_argument():
    lines, mask = make_lines((*FIRST, 4.0)), jnp.ones(3, bool)
    targets, params = jnp.asarray(TARGETS), {"match_m": 5.0, "gate": 1.0}
    with pytest.raises(ValueError, match="truth_position_m: got shape"):
        initiation_scores(lines, targets[0], mask, **params)
    with pytest.raises(ValueError, match="truth_mask: got shape"):
        initiation_scores(lines, targets, mask[:2], **params)
    with pytest.raises(ValueError, match=r"lines\.votes: got shape"):
        initiation_scores(lines._replace(votes=jnp.ones(2)), targets, mask, **params)
    with pytest.raises(ValueError, match=r"lines\.rho_m: got shape"):
        initiation_scores(lines._replace(rho_m=jnp.ones(2)), targets, mask, **params)
    with pytest.raises(ValueError, match="number of targets: got 0"):
        initiation_scores(lines, targets[:0], mask[:0], **params)
    with pytest.raises(ValueError, match="vote_rho_m: got shape"):
        divergence(jnp.ones(3), jnp.ones(2), jnp.ones(2), 0.0, 0.0, 1.0, 1.0)
