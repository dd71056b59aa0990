"""Candidate pairs against loops over all of them."""

import functools

import jax
import numpy as np
import pytest
from hypothesis import given

from jaxtrack.hough.pairs import candidate_pairs, pair_covariances
from jaxtrack.types import Scan
from tests.hough.cases import ORIGIN, SHAPES, SPEED, few, looks, random_looks
from tests.oracles import lines, pairs


@functools.cache
def jitted(size, gated):
    return jax.jit(
        lambda scan, origin, speed: candidate_pairs(
            scan, origin, speed if gated else None, pairs=size
        )
    )


def check(scan, *, gated, size=36):
    origin = np.array(ORIGIN)
    table = jitted(size, gated)(scan, origin, SPEED)
    expected = pairs.candidate_pairs(scan, *(SPEED if gated else ()))
    covariance = pair_covariances(table, origin, np.float64(7.0))
    for k in range(1, len(scan.time_s)):
        here = [pair for pair in expected if pair.k == k]
        row = jax.tree.map(lambda x, k=k: np.asarray(x[k - 1]), table)
        assert row.overflow == (len(here) > size)
        here = here[:size]
        np.testing.assert_array_equal(row.mask, np.arange(size) < len(here))
        for n, pair in enumerate(here):
            assert (row.first[n], row.second[n]) == (pair.i, pair.j)
            np.testing.assert_array_equal(row.first_m[n], pair.first)
            np.testing.assert_array_equal(row.second_m[n], pair.second)
            line = lines.line_through(pair.first, pair.second, origin)
            got = (row.rho_m[n], row.theta_rad[n], row.weight[n], row.dt_s[n])
            wanted = (*line, pair.weight, pair.t_second - pair.t_first)
            np.testing.assert_allclose(got, wanted, rtol=1e-10, atol=1e-10)
            c = lines.line_covariance(pair.first, pair.second, origin, 7.0)
            got = [x[k - 1, n] for x in covariance]
            np.testing.assert_allclose(got, [c[0, 0], c[0, 1], c[1, 1]], rtol=1e-10, atol=1e-10)
        np.testing.assert_array_equal(row.weight[len(here) :], 0.0)
        for j in range(scan.mask.shape[1]):
            found = np.arange(row.start[j], row.start[j] + row.count[j])
            of_j = [n for n, pair in enumerate(here) if pair.j == j]
            assert found.tolist() == of_j
    return len(expected)


@few
@given(looks(shapes=SHAPES[:1]))
def test_pairs_equal_the_oracle_without_a_gate(scan):
    check(scan, gated=False)


@few
@given(looks())
def test_pairs_equal_the_oracle_within_the_speed_gate(scan):
    check(scan, gated=True)


def test_too_small_a_table_keeps_the_first_pairs_and_says_so():
    scan = random_looks(np.random.default_rng(0), 4, 5)
    assert check(scan, gated=True, size=9) > 3 * 9


def test_fields_left_out_are_ones_and_zeros():
    scan = random_looks(np.random.default_rng(3), 4, 5)
    check(scan._replace(weight=None, delay_s=None), gated=True)


def test_pairs_without_a_direction_or_without_time_do_not_count():
    position = np.array([[[0.0, 0.0], [1.0, 0.0]], [[0.0, 0.0], [2.0, 0.0]]])
    scan = Scan(np.arange(2.0), np.ones(2, bool), position, np.ones((2, 2), bool))  # pyright: ignore
    assert check(scan, gated=False) == 3
    assert check(scan._replace(time_s=np.zeros(2)), gated=False) == 0  # pyright: ignore


def test_one_look_has_no_pairs():
    scan = random_looks(np.random.default_rng(0), 2, 3)
    with pytest.raises(ValueError, match="number of looks: got 1"):
        candidate_pairs(jax.tree.map(lambda x: x[:1], scan), np.zeros(2), None, pairs=9)  # pyright: ignore
