"""Gates from a stated false-track rate: by hand, and against counting."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from jaxtrack.hough import gate_for_false_rate
from tests.hough.cases import few

gate_for = jax.jit(gate_for_false_rate)
SCENES, LINES = 6, 4


def passing(votes, mask, gate):
    """Return how many lines are found in all scenes together: those with votes ≥ gate."""
    return sum(
        bool(there) and float(vote) >= gate and float(vote) > 0.0
        for vote, there in zip(votes.ravel(), mask.ravel(), strict=True)
    )


@pytest.mark.parametrize(
    ("false_per_run", "found"), [(0.0, 0), (0.24, 0), (0.25, 1), (0.5, 2), (0.74, 2), (1.5, 6)]
)
def test_by_hand(false_per_run, found):
    votes = np.array([[9.0, 4.0], [5.0, 3.0], [6.0, 2.0], [8.0, 1.0]])
    mask = np.ones((4, 2), bool)
    gate = float(gate_for(votes, mask, false_per_run))
    in_order = sorted(votes.ravel())[::-1]
    assert gate == np.nextafter(in_order[found], np.inf)
    assert passing(votes, mask, gate) == found


def test_the_rate_is_met_to_the_last_line_despite_rounding():
    # 0.1 × 30 and 0.07 × 100 are a hair above and below whole numbers, or right on them.
    for scenes, rate in ((30, 0.1), (100, 0.07), (100, 0.29), (300, 0.05)):
        votes = np.random.default_rng(scenes).uniform(size=(scenes, 3))
        gate = gate_for(votes, np.ones(votes.shape, bool), rate)
        assert passing(votes, np.ones(votes.shape, bool), float(gate)) == round(scenes * rate)


def test_of_lines_with_equal_votes_none_passes_or_all():
    votes = np.array([[7.0, 3.0], [3.0, 3.0], [3.0, 1.0], [2.0, 1.0]])
    mask = np.ones(votes.shape, bool)
    # Two of the four lines with 3 votes would meet the rate, but they cannot be told apart.
    gate = float(gate_for(votes, mask, 0.75))
    assert gate == np.nextafter(3.0, np.inf)
    assert passing(votes, mask, gate) == 1
    assert passing(votes, mask, float(gate_for(votes, mask, 1.25))) == 5


def test_without_lines_every_line_may_pass():
    votes = np.zeros((SCENES, LINES))
    assert gate_for(votes, np.zeros(votes.shape, bool), 0.1) == 0.0
    assert gate_for(np.full_like(votes, np.nan), np.zeros(votes.shape, bool), 0.1) == 0.0


def test_a_rate_beyond_the_number_of_lines_lets_all_pass():
    votes = np.random.default_rng(0).uniform(1.0, 2.0, (SCENES, LINES))
    mask = np.ones(votes.shape, bool)
    assert gate_for(votes, mask, float(LINES)) == 0.0
    assert gate_for(votes, mask, 1e6) == 0.0
    # Nor do lines that do not exist stand in the way.
    mask[:, 1:] = False
    assert gate_for(votes, mask, 1.0) == 0.0
    assert gate_for(votes, mask, 0.99) > 0.0


@few
@given(st.integers(0, 2**32 - 1), st.booleans(), st.sampled_from([0.0, 0.1, 0.5, 1.0, 2.3]))
def test_no_lower_gate_keeps_the_rate(seed, whole, false_per_run):
    rng = np.random.default_rng(seed)
    votes = rng.integers(1, 6, (SCENES, LINES)) * 1.0 if whole else rng.exponential(size=(6, 4))
    mask = rng.random(votes.shape) < 0.7
    votes[~mask] = np.nan
    gate = float(gate_for(votes, mask, false_per_run))
    allowed = false_per_run * SCENES + 1e-9
    assert passing(votes, mask, gate) <= allowed
    lower = [vote for vote in votes[mask] if vote < gate]
    if lower:
        assert passing(votes, mask, max(lower)) > allowed
    else:
        assert gate == 0.0


def test_in_float32_the_gate_is_the_next_number():
    votes = np.array([[9.0, 4.0], [5.0, 3.0]], np.float32)
    gate = gate_for(votes, np.ones(votes.shape, bool), jnp.float32(0.5))
    assert gate.dtype == np.float32
    assert gate == np.nextafter(np.float32(5.0), np.float32(np.inf))
