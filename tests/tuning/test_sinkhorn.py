"""The smoothed OSPA and GOSPA: their oracles, bounds, slopes."""

import functools

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from jaxtrack.metrics import gospa, ospa
from jaxtrack.tuning import sinkhorn_gospa, sinkhorn_ospa
from tests.metrics.differences import assert_gradients_agree
from tests.oracles import tuning as oracle

ROWS, COLUMNS = 4, 5
SMOOTH = {"ospa": sinkhorn_ospa, "gospa": sinkhorn_gospa}
EXACT = {"ospa": ospa, "gospa": gospa}
either = pytest.mark.parametrize("name", SMOOTH)


@functools.cache
def smooth(name, iterations=100):
    def distance(x, xm, y, ym, cutoff, order, temperature, share=None):
        return SMOOTH[name](
            x, xm, y, ym, cutoff=cutoff, order=order, temperature=temperature,
            iterations=iterations, existence=share,
        )  # fmt: skip

    return jax.jit(distance)


@functools.cache
def exact(name):
    return jax.jit(lambda *sets: EXACT[name](*sets[:4], cutoff=sets[4], order=sets[5]).distance)


def sets(seed, there=0.7, dtype=np.float64):
    rng = np.random.default_rng(seed)
    found = []
    for size in (ROWS, COLUMNS):
        mask = rng.random(size) < there
        points = np.where(mask[:, None], rng.normal(scale=5.0, size=(size, 2)), np.nan)
        found += [points.astype(dtype), mask]
    return found


@either
@pytest.mark.parametrize("temperature", [0.3, 0.1])
@pytest.mark.parametrize("order", [1.0, 2.0, 2.5])
def test_it_equals_plain_scaling(name, temperature, order):
    plain = {"ospa": oracle.sinkhorn_ospa, "gospa": oracle.sinkhorn_gospa}[name]
    for seed in range(8):
        x, xm, y, ym = sets(seed)
        got = smooth(name, 1000)(x, xm, y, ym, 8.0, order, temperature)
        expected = plain(x[xm], y[ym], 8.0, order, temperature)
        np.testing.assert_allclose(got.distance, expected, rtol=1e-6, atol=1e-9)


@either
@pytest.mark.parametrize("iterations", [1, 5, 100])
def test_the_exact_distance_is_within_the_bound_however_early_it_stops(name, iterations):
    close = 0
    for seed in range(60):
        case = (*sets(seed), 8.0, (1.0, 2.0)[seed % 2])
        for temperature in (0.3, 0.03, 0.003):
            got = smooth(name, iterations)(*case, temperature)
            error = abs(float(got.distance - exact(name)(*case)))
            assert error <= float(got.bound) * (1 + 1e-9) + 1e-9
            close += error > 0.9 * float(got.bound) > 0
    assert close > 0  # a bound that is never nearly met would say little


@either
@pytest.mark.parametrize("order", [1.0, 2.0])
def test_estimates_that_exist_in_part_are_masses(name, order):
    # Four copies of each truth, and a copy of an estimate for each quarter of it.
    close = 0
    for seed in range(12):
        x, xm, y, ym = sets(seed, there=0.8)
        quarters = np.random.default_rng(seed).integers(0, 5, ROWS) * xm
        copies = np.repeat(x, 4, axis=0), np.repeat(y, 4, axis=0)
        there = (np.arange(4) < quarters[:, None]).ravel(), np.repeat(ym, 4)
        if max(there[0].sum(), there[1].sum()) < 4:
            continue  # OSPA has no less than one member
        got = smooth(name)(x, xm, y, ym, 8.0, order, 0.02, quarters / 4)
        expected = exact(name)(copies[0], there[0], copies[1], there[1], 8.0, order)
        # GOSPA is of all together, of which there are four times as many.
        expected = expected / (4 ** (1 / order) if name == "gospa" else 1)
        error = abs(float(got.distance - expected))
        assert error <= float(got.bound) + 1e-9
        close += error < 0.5
    assert close > 5


@either
def test_existence_of_one_is_none_and_of_nothing_alone_counts_smoothly(name):
    x, xm, y, ym = sets(3)
    whole = smooth(name)(x, xm, y, ym, 8.0, 2.0, 0.1, np.ones(ROWS))
    np.testing.assert_allclose(whole, smooth(name)(x, xm, y, ym, 8.0, 2.0, 0.1), rtol=1e-12)
    none = np.zeros_like(ym)
    one = np.arange(ROWS) == 0
    for share in (0.0, 0.3, 1.0):
        alone = smooth(name)(np.nan_to_num(x), one, y, none, 8.0, 1.0, 1e-3, share * one)
        cost = {"ospa": 8.0, "gospa": 4.0}[name]
        np.testing.assert_allclose(alone.distance, cost * share, atol=0.05)


@either
def test_the_slope_in_the_existence_equals_differences(name):
    x, xm, y, ym = sets(11)
    points = np.nan_to_num(x)

    def loss(share):
        return smooth(name)(points, xm, y, ym, 8.0, 2.0, 0.1, share).distance

    for share in ([0.3, 0.8, 0.6, 0.4], [0.9, 0.1, 0.2, 0.3]):
        (slope,) = assert_gradients_agree(loss, np.array(share), rtol=1e-5, atol=1e-8)
        assert np.abs(slope).max() > 1e-2
        assert not slope[~xm].any()


@either
def test_it_is_never_below_and_tends_to_the_exact_distance(name):
    for seed in range(20):
        case = (*sets(seed), 8.0, 1.0)
        expected = float(exact(name)(*case))
        errors = [
            float(smooth(name, 1000)(*case, t).distance) - expected for t in (0.1, 0.01, 1e-3)
        ]
        count = max(case[1].sum(), case[3].sum(), 1)
        times = {"ospa": 1, "gospa": count}[name]
        for error, temperature in zip(errors, (0.1, 0.01, 1e-3), strict=True):
            assert -0.01 * times <= error <= 8.0 * temperature * times * np.log(count) + 1e-9
        assert abs(errors[2]) <= 0.02 * times


@either
def test_order_and_padding_change_nothing(name):
    x, xm, y, ym = sets(3)
    expected = smooth(name)(x, xm, y, ym, 8.0, 2.0, 0.1)
    rng = np.random.default_rng(0)
    i, j = rng.permutation(ROWS), rng.permutation(COLUMNS)
    got = smooth(name)(x[i], xm[i], y[j], ym[j], 8.0, 2.0, 0.1)
    np.testing.assert_allclose(got, expected, rtol=1e-12)
    longer = np.concatenate([x, np.full((2, 2), np.nan)]), np.append(xm, [False, False])
    np.testing.assert_allclose(smooth(name)(*longer, y, ym, 8.0, 2.0, 0.1), expected, rtol=1e-12)


@either
def test_vmap_is_a_loop(name):
    cases = [(*sets(seed), 8.0, 2.0, 0.1) for seed in range(4)]
    together = jax.vmap(smooth(name))(*(np.stack(x) for x in zip(*cases, strict=True)))
    alone = [smooth(name)(*case).distance for case in cases]
    np.testing.assert_allclose(together.distance, alone, rtol=1e-12)


@either
@pytest.mark.parametrize("order", [1.0, 2.0])
def test_jitted_gradients_equal_differences(name, order):
    x, xm, y, ym = sets(11)

    def loss(x, y, cutoff, temperature):
        hide = lambda points, mask: jnp.where(mask[:, None], points, jnp.nan)
        return SMOOTH[name](
            hide(x, xm), xm, hide(y, ym), ym, cutoff=cutoff, order=order, temperature=temperature
        ).distance

    clean = np.nan_to_num(x), np.nan_to_num(y)
    gradients = assert_gradients_agree(loss, *clean, 9.0, 0.1, rtol=1e-5, atol=1e-8)
    assert np.abs(gradients[0]).max() > 1e-3
    assert not gradients[0][~xm].any()


@either
def test_the_gradient_has_no_kink_where_the_assignment_changes(name):
    # Two estimates half-way between two truths: the exact gradient jumps when one moves past.
    truths, there = np.array([[0.0, 1.0], [0.0, -1.0]]), np.ones(2, bool)

    def pull(distance):
        def loss(shift):
            apart = jnp.array([[1.0, 0.0], [-1.0, 0.0]])
            estimates = apart + shift * jnp.array([[0.0, 1.0], [0.0, -1.0]])
            return distance(estimates, there, truths, there)

        slope = jax.jit(jax.grad(loss))
        return abs(float(slope(1e-4)) - float(slope(-1e-4)))

    soft = lambda *s: SMOOTH[name](*s, cutoff=9.0, order=2.0, temperature=0.05).distance
    hard = lambda *s: EXACT[name](*s, cutoff=9.0, order=2.0).distance
    assert pull(hard) > 1.0
    assert pull(soft) < 1e-2


@either
@pytest.mark.parametrize("dtype", [np.float32, np.float64])
def test_values_and_slopes_are_finite_and_of_one_precision(name, dtype):
    run = jax.jit(
        jax.value_and_grad(lambda *case: smooth(name, 30)(*case).distance, argnums=(0, 2, 4, 5, 6))
    )
    number = lambda x: jnp.asarray(x, dtype)
    full, none = np.ones(ROWS, bool), np.zeros(ROWS, bool)
    same = np.full((ROWS, 2), 3.0, dtype)
    far = np.arange(2.0 * ROWS).reshape(ROWS, 2).astype(dtype) * 1e6
    for x in (same, far, np.where(none[:, None], same, np.nan).astype(dtype)):
        for xm in (full, none):
            x_seen = x if np.isfinite(x).all() or not xm.any() else same
            for ym in (full, none):
                for temperature in (1e-3, 1.0):
                    sets = x_seen, xm, same, ym
                    numbers = number(8.0), number(2.0), number(temperature)
                    for leaf in jax.tree.leaves(run(*sets, *numbers)):
                        assert leaf.dtype == dtype
                        assert np.isfinite(leaf).all()


@either
@pytest.mark.slow
def test_single_precision_agrees(name):
    for seed in range(5):
        one = smooth(name)(*sets(seed, dtype=np.float32), *np.float32([8.0, 2.0, 0.1]))
        two = smooth(name)(*sets(seed), 8.0, 2.0, 0.1)
        np.testing.assert_allclose(one.distance, two.distance, rtol=1e-4)
        slope = jax.jit(jax.grad(lambda *case: smooth(name)(*case).distance))
        small = slope(*sets(seed, dtype=np.float32), *np.float32([8.0, 2.0, 0.1]))
        np.testing.assert_allclose(small, slope(*sets(seed), 8.0, 2.0, 0.1), rtol=1e-2, atol=1e-4)


@either
def test_what_cannot_be_is_refused(name):
    x, xm, y, ym = sets(0)
    with pytest.raises(ValueError, match=r"temperature: got 0\.0, want a positive, finite number"):
        SMOOTH[name](x, xm, y, ym, cutoff=8.0, order=1.0, temperature=0.0)
    with pytest.raises(ValueError, match="iterations: got 0"):
        SMOOTH[name](x, xm, y, ym, cutoff=8.0, order=1.0, temperature=0.1, iterations=0)
