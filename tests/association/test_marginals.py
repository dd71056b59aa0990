"""Marginal association probabilities: exact against all joint events, and the approximations."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from jaxtrack.association import (
    AssociationParams,
    Predicted,
    belief_propagation,
    jpda,
    likelihood_ratios,
    pda,
)
from jaxtrack.types import Scan
from tests.metrics.differences import assert_gradients_agree
from tests.oracles import association
from tests.oracles import jpda as enumeration

SHAPES = ((5, 6), (3, 2))  # tracks, detections
few = settings(max_examples=20, deadline=None, derandomize=True, database=None)
exact = jax.jit(jpda.marginals)
alone = jax.jit(pda.marginals)
loopy = jax.jit(belief_propagation.marginals, static_argnames="iterations")


def problem(seed, shape, *, zeros=0.4, decades=2.0):
    """Return ratios and misses: many zeros, weights over several decades."""
    rng = np.random.default_rng(seed)
    ratio = 10.0 ** rng.uniform(-decades, decades, shape) * (rng.random(shape) >= zeros)
    return ratio, rng.uniform(0.02, 1.0, shape[0])


problems = st.builds(
    problem,
    st.integers(0, 2**32 - 1),
    st.sampled_from(SHAPES),
    zeros=st.sampled_from((0.0, 0.4, 0.8, 1.0)),
    decades=st.sampled_from((0.5, 2.0, 5.0)),
)


@few
@given(problems)
def test_exact_marginals_equal_the_enumeration_of_all_joint_events(problem):
    ratio, miss = problem
    got = exact(ratio, miss)
    np.testing.assert_allclose(got, enumeration.marginals(ratio, miss), rtol=1e-12, atol=1e-12)
    assert not got[:, :-1][ratio == 0].any()


@pytest.mark.slow  # compiles for long where nothing is cached
@few
@given(problems)
def test_order_of_tracks_and_detections_does_not_matter_and_padding_changes_nothing(problem):
    ratio, miss = problem
    for marginals in (exact, loopy):
        got = marginals(ratio, miss)
        rows, columns = np.arange(len(miss))[::-1], np.arange(ratio.shape[1])[::-1]
        there = marginals(ratio[rows][:, columns], miss[rows])
        np.testing.assert_allclose(there[:, :-1], got[rows][:, columns], rtol=1e-9, atol=1e-12)
        if len(miss) > 3:  # one shape is enough to compile for
            continue
        padded = marginals(np.pad(ratio, ((0, 1), (0, 2))), np.append(miss, 0.3))
        np.testing.assert_allclose(padded[:-1, :-3], got[:, :-1], rtol=1e-9, atol=1e-12)
        np.testing.assert_allclose(padded[:-1, -1], got[:, -1], rtol=1e-9, atol=1e-12)
        np.testing.assert_allclose(padded[-1], [*np.zeros(ratio.shape[1] + 2), 1.0], atol=1e-12)


@few
@given(problems)
def test_pda_is_the_quotient_and_what_a_track_alone_gets(problem):
    ratio, miss = problem
    np.testing.assert_allclose(alone(ratio, miss), association.pda(ratio, miss), rtol=1e-12)
    for j in range(len(miss) if len(miss) < 4 else 0):
        one = ratio[j][None], miss[j][None]
        for marginals in (exact, loopy):
            np.testing.assert_allclose(marginals(*one), alone(*one), rtol=1e-12, atol=1e-15)


def test_eight_tracks_and_many_detections_add_up_to_one():
    ratio, miss = problem(1, (8, 32), zeros=0.3)
    got = exact(ratio, miss)
    np.testing.assert_allclose(got.sum(1), 1.0, rtol=1e-12)
    assert (got[:, :-1].sum(0) <= 1 + 1e-12).all()
    single = exact(ratio.astype(np.float32), miss.astype(np.float32))
    assert single.dtype == np.float32
    np.testing.assert_allclose(single, got, rtol=2e-4, atol=1e-6)


@pytest.mark.parametrize(
    "ratio",
    [
        np.where(np.arange(8) == 0, 1e9, 0.0)[None].repeat(8, 0),  # all want one detection
        1e9 * np.eye(8),  # each has its own
        1e9 * (np.eye(8) + 0.01),  # and could take any other
        1e-9 * np.ones((8, 8)),
        np.zeros((8, 8)),
    ],
    ids=["one for all", "one for each", "any", "unlikely", "none"],
)
@pytest.mark.parametrize("miss", [0.1, 0.0])
def test_single_precision_stays_right_where_products_overflow_or_underflow(ratio, miss):
    missed = np.full(8, miss)
    got = exact(ratio.astype(np.float32), missed.astype(np.float32))
    np.testing.assert_allclose(got, exact(ratio, missed), rtol=1e-4, atol=1e-5)
    near = loopy(ratio.astype(np.float32), missed.astype(np.float32))
    assert np.isfinite(near).all()
    np.testing.assert_allclose(near.sum(1), 1.0, rtol=1e-5)


@pytest.mark.parametrize("marginals", [jpda.marginals, belief_propagation.marginals])
def test_gradients_of_marginals_are_central_differences_also_under_jit_and_vmap(marginals):
    ratio, miss = problem(3, (3, 4), zeros=0.0, decades=0.5)
    scale = jnp.asarray(np.random.default_rng(0).normal(size=(3, 5)))
    loss = lambda ratio, miss: (scale * marginals(ratio, miss) ** 2).sum()
    assert_gradients_agree(loss, ratio, miss)
    batch = jax.jit(jax.vmap(jax.grad(loss), in_axes=(0, None)))(np.stack([ratio, 2 * ratio]), miss)
    np.testing.assert_allclose(batch[0], jax.jit(jax.grad(loss))(ratio, miss), rtol=1e-10)


def test_gradients_of_messages_that_have_not_settled_are_those_of_what_is_returned():
    crowded = np.full((4, 4), 50.0) * np.random.default_rng(1).uniform(0.8, 1.2, (4, 4))
    miss = np.full(4, 0.02)
    few, many = (loopy(crowded, miss, iterations=n) for n in (5, 200))
    assert np.abs(few - many).max() > 1e-3
    marginals = lambda ratio, miss: belief_propagation.marginals(ratio, miss, iterations=5)
    scale = jnp.asarray(np.random.default_rng(0).normal(size=(4, 5)))
    loss = lambda ratio, miss: (scale * marginals(ratio, miss) ** 2).sum()
    assert_gradients_agree(loss, crowded, miss)


def test_second_derivatives_are_differences_of_gradients_both_ways():
    ratio, miss = problem(3, (2, 3), zeros=0.0, decades=0.5)
    scale = jnp.asarray(np.random.default_rng(0).normal(size=(2, 4)))
    loss = lambda ratio: (scale * jpda.marginals(ratio, miss) ** 2).sum()
    slope = jax.jit(jax.grad(loss))
    forth = jax.jit(jax.hessian(loss))(ratio)
    back = jax.jit(jax.jacrev(jax.grad(loss)))(ratio)
    np.testing.assert_allclose(forth, back, rtol=1e-9, atol=1e-12)
    for index in np.ndindex(ratio.shape):
        step = np.zeros_like(ratio)
        step[index] = 1e-5
        expected = (slope(ratio + step) - slope(ratio - step)) / 2e-5
        np.testing.assert_allclose(forth[index], expected, rtol=1e-5, atol=1e-7)


def test_a_pair_that_may_not_be_has_the_gradient_of_its_first_weight():
    ratio, miss = problem(4, (3, 4), zeros=0.0, decades=0.5)
    ratio[0], ratio[1, 2] = 0.0, 0.0  # one row without any, one entry
    step = 1e-7
    gradient = jax.jit(jax.grad(lambda w, j, i: jpda.marginals(w, miss)[j, i]))
    for j, i in ((0, 1), (1, 2)):
        more = ratio.copy()
        more[j, i] = step
        got = gradient(ratio, j, i)[j, i]
        np.testing.assert_allclose(got, exact(more, miss)[j, i] / step, rtol=1e-5)
        assert got > 0


def test_belief_propagation_is_close_and_exact_where_gates_do_not_overlap():
    rng = np.random.default_rng(5)
    worst, total = 0.0, 0.0
    for seed in range(200):
        ratio, miss = problem(seed, (5, 6), zeros=0.5, decades=1.0)
        error = np.abs(loopy(ratio, miss) - exact(ratio, miss))
        worst, total = max(worst, error.max()), total + error.mean()
    assert worst < 0.2
    assert total / 200 < 0.01
    assert worst > 1e-6  # it is an approximation
    apart = np.zeros((5, 6))
    apart[rng.integers(5, size=6), np.arange(6)] = rng.uniform(1, 50, 6)
    np.testing.assert_allclose(loopy(apart, miss), exact(apart, miss), rtol=1e-12, atol=1e-14)
    # Two tracks that share one detection: no loop either.
    shared = np.zeros((5, 6))
    shared[:2, 0], shared[0, 1], shared[1, 2] = 30.0, 4.0, 2.0
    np.testing.assert_allclose(loopy(shared, miss), exact(shared, miss), rtol=1e-9, atol=1e-14)


@pytest.mark.parametrize("apart_m", [4.0, 40.0])
def test_messages_are_left_out_only_where_they_say_nothing(apart_m):
    at = jnp.array([[0.0, 0.0], [apart_m, 0.0]])
    noise = jnp.stack([jnp.eye(2)] * 2)
    params = AssociationParams(0.9, 1e-3, 30.0)

    def found(places, associate):
        predicted = Predicted(at, noise, jnp.eye(2), jnp.ones(2, bool))
        scan = Scan(jnp.array(0.0), jnp.array(True), places, jnp.ones(3, bool))
        if associate:
            return belief_propagation.associate(predicted, scan, params).weight
        return loopy(*likelihood_ratios(predicted, scan, params))[:, :-1]

    places = jnp.array([[1.0, 0.5], [apart_m - 1.0, -0.5], [2.0, 3.0]])
    scale = jnp.asarray(np.random.default_rng(0).normal(size=(2, 3)))
    loss = lambda places, associate: (scale * found(places, associate) ** 2).sum()
    slopes = jax.jit(jax.value_and_grad(loss), static_argnums=1)
    (value, got), (value_too, expected) = slopes(places, True), slopes(places, False)
    np.testing.assert_allclose(value, value_too, rtol=1e-13)
    np.testing.assert_allclose(got, expected, rtol=1e-11, atol=1e-14)
    assert ((found(places, True) > 0).sum(0) > 1).any() == (apart_m < 10.0)
    assert_gradients_agree(lambda places: loss(places, True), np.asarray(places))


def test_vmap_is_a_loop():
    several = [problem(seed, (3, 2)) for seed in range(4)]
    ratio, miss = (np.stack(x) for x in zip(*several, strict=True))
    for marginals in (exact, loopy):
        got = jax.jit(jax.vmap(marginals))(ratio, miss)
        for n, one in enumerate(several):
            np.testing.assert_allclose(got[n], marginals(*one), rtol=1e-12, atol=1e-15)


def test_without_tracks_or_detections():
    for marginals in (exact, alone, loopy):
        np.testing.assert_allclose(marginals(jnp.zeros((2, 0)), jnp.full(2, 0.3)), 1.0, rtol=1e-15)
        assert marginals(jnp.zeros((0, 3)), jnp.zeros(0)).shape == (0, 4)


def test_errors_name_the_argument():
    with pytest.raises(ValueError, match="got 11 tracks, want at most 10; belief_propagation"):
        jpda.marginals(jnp.ones((11, 2)), jnp.ones(11))
    with pytest.raises(ValueError, match=r"miss: got shape \[3\], want \[2\]"):
        jpda.marginals(jnp.ones((2, 2)), jnp.ones(3))
    with pytest.raises(ValueError, match="iterations: got 0"):
        belief_propagation.marginals(jnp.ones((2, 2)), jnp.ones(2), iterations=0)


@pytest.mark.parametrize("marginals", [jpda.marginals, belief_propagation.marginals])
def test_the_largest_numbers_are_no_misses_in_single_precision(marginals):
    one = lambda *ratio: marginals(jnp.array([ratio], jnp.float32), jnp.float32([0.1]))[0]
    np.testing.assert_allclose(one(1e38, 1e38), [0.5, 0.5, 0.0], atol=1e-6)
    np.testing.assert_allclose(one(jnp.inf, 1.0), [1.0, 0.0, 0.0], atol=1e-6)


def test_many_terms_are_summed_as_few_are():
    """Padding to more detections than are summed one by one changes neither value nor slope."""
    rng = np.random.default_rng(5)
    ratio, miss = rng.uniform(0.2, 3.0, (3, 4)), jnp.asarray(rng.uniform(0.3, 1.0, 3))

    def both(wide):
        def loss(ratio):
            found = loopy(jnp.pad(ratio, ((0, 0), (0, wide))), miss)[:, :4]
            return jnp.sin(3 * found).sum(), found

        slope, found = jax.jit(jax.grad(loss, has_aux=True))(ratio)
        return slope, found

    for got, expected in zip(both(40), both(0), strict=True):
        np.testing.assert_allclose(got, expected, rtol=1e-9)
