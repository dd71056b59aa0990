"""The greedy assignment against one pair at a time."""

import jax
import numpy as np

from jaxtrack.association.nearest import greedy_pairs


def test_greedy_takes_the_closest_pair_first_and_of_equals_the_first_in_reading_order():
    rng = np.random.default_rng(0)
    distance = rng.integers(0, 6, (200, 5, 7)).astype(float)  # many are equal
    allowed = rng.random(distance.shape) < rng.random((200, 1, 1))
    found = jax.jit(jax.vmap(greedy_pairs))(distance, allowed)
    for d, left, columns in zip(distance, allowed.copy(), found, strict=True):
        expected = np.full(5, -1)
        while left.any():
            row, column = divmod(int(np.argmin(np.where(left, d, np.inf))), 7)
            expected[row] = column
            left[row], left[:, column] = False, False
        np.testing.assert_array_equal(columns, expected)
