import jax
import jax.numpy as jnp
import numpy as np
import pytest

from jaxtrack.numerics import check_array, check_choice, check_size
from jaxtrack.numerics.checks import check_positive, check_probability, check_scans
from jaxtrack.types import Scan


@pytest.mark.parametrize(
    "value",
    [jnp.zeros((4, 2)), np.zeros((4, 2), dtype=np.int64), np.ones((1, 2), bool)],
)
def test_real_arrays_of_the_wanted_shape_pass(value):
    check_array("points_m", value, shape=("N", 2))


def test_any_shape_passes_where_none_is_wanted():
    check_array("weight", 1.0)
    check_array("weight", jnp.zeros((2, 3, 4)))
    check_array("weight", 1.0, shape=())


@pytest.mark.parametrize(
    ("value", "message"),
    [
        (jnp.zeros((4, 3)), r"points_m: got shape \[4, 3\], want \[N, 2\]"),
        (jnp.zeros(2), r"points_m: got shape \[2\], want \[N, 2\]"),
        (1.0, r"points_m: got shape \[\], want \[N, 2\]"),
    ],
)
def test_a_wrong_shape_is_told_with_what_is_wanted(value, message):
    with pytest.raises(ValueError, match=message):
        check_array("points_m", value, shape=("N", 2))


@pytest.mark.parametrize(
    "value",
    [
        "a word",
        "a",
        "f",
        None,
        [0.0, 1.0],
        np.array([1j]),
        jax.random.key(0),
        np.array(["a"]),
        object(),
    ],
)
def test_what_is_no_array_of_real_numbers_is_a_type_error(value):
    with pytest.raises(TypeError, match="points_m: got"):
        check_array("points_m", value)


def test_arrays_are_checked_while_tracing():
    @jax.jit
    def function(x):
        check_array("x", x, shape=(3,))
        return x

    function(jnp.zeros(3))
    with pytest.raises(ValueError, match=r"x: got shape \[2\], want \[3\]"):
        function(jnp.zeros(2))


@pytest.mark.parametrize("value", [1, 8, np.int64(3)])
def test_sizes_come_back_as_python_ints(value):
    size = check_size("max_lines", value)
    assert size == value
    assert type(size) is int


def test_a_size_may_be_allowed_to_be_zero():
    assert check_size("max_lines", 0, at_least=0) == 0


@pytest.mark.parametrize("value", [0, -1])
def test_too_small_a_size(value):
    with pytest.raises(ValueError, match=f"max_lines: got {value}, want an int ≥ 1"):
        check_size("max_lines", value)


@pytest.mark.parametrize("value", [2.0, "2", None, True])
def test_no_integer_is_no_size(value):
    with pytest.raises(TypeError, match="max_lines: got"):
        check_size("max_lines", value)


def test_choices():
    assert check_choice("landing", "spread", ("own_cell", "spread")) == "spread"
    with pytest.raises(ValueError, match="landing: got 'near', want one of own_cell, spread"):
        check_choice("landing", "near", ("own_cell", "spread"))


def test_positive_numbers_are_kept_and_others_refused_or_raised():
    assert float(check_positive("eps", 2.5, jnp.float64)) == 2.5
    for wrong in (0.0, -1.0, float("nan"), float("inf"), np.array([1.0, 0.0])):
        with pytest.raises(ValueError, match=r"eps: got .*, want a positive, finite number"):
            check_positive("eps", wrong, jnp.float64)
    raised = jax.jit(jax.value_and_grad(lambda x: check_positive("eps", x, jnp.float64)))
    for wrong in (0.0, -1.0, float("nan")):
        assert raised(wrong) == (np.finfo(np.float64).eps, 0.0)
    most, slope = raised(float("inf"))
    assert np.isfinite(most**2)
    assert slope == 0


def test_probabilities_are_kept_and_others_refused_or_moved():
    assert float(check_probability("p", 0.5, jnp.float64)) == 0.5
    for wrong in (-0.1, 1.1, float("nan")):
        with pytest.raises(ValueError, match=r"p: got .*, want a probability from 0 to 1"):
            check_probability("p", wrong, jnp.float64)
    moved = jax.jit(lambda x: check_probability("p", x, jnp.float64))
    assert [float(moved(x)) for x in (-1.0, 0.25, 7.0, float("nan"))] == [0.0, 0.25, 1.0, 0.0]


@pytest.mark.parametrize(
    ("field", "value", "message"),
    [
        ("position_m", np.zeros((3, 2)), "position_m: got shape"),
        ("position_m", np.zeros((3, 4, 2), int), "want floating numbers"),
        ("position_m", np.zeros((3, 0, 2)), "places for detections: got 0"),
        ("mask", np.ones((3, 5), bool), r"mask: got shape \[3, 5\], want \[3, 4\]"),
        ("mask", np.ones((3, 4)), "scans.mask: got dtype float64, want booleans"),
        ("mask", np.full((3, 4), 2), "scans.mask: got dtype int64, want booleans"),
        ("valid", np.ones(3), "scans.valid: got dtype float64, want booleans"),
        ("time_s", np.zeros(2), "time_s: got shape"),
        ("covariance_m2", np.zeros((3, 4, 2)), "covariance_m2: got shape"),
        ("weight", np.zeros(4), "weight: got shape"),
    ],
)
def test_fields_of_looks_that_do_not_fit_are_named(field, value, message):
    scans = Scan(np.zeros(3), np.ones(3, bool), np.zeros((3, 4, 2)), np.ones((3, 4), bool))
    check_scans(scans)
    wrong = scans._replace(**{field: value})
    for check in (check_scans, jax.jit(check_scans)):
        with pytest.raises((TypeError, ValueError), match=message):
            check(wrong)


def test_known_looks_with_broken_values_are_refused_and_traced_ones_seen_as_absent():
    scans = Scan(np.arange(3.0), np.ones(3, bool), np.zeros((3, 4, 2)), np.ones((3, 4), bool))
    scans.position_m[1, 2, 0] = np.inf
    with pytest.raises(ValueError, match=r"scans.position_m: got .* at \[1, 2\], want finite"):
        check_scans(scans)
    scans.time_s[2] = np.nan
    sound = jax.jit(check_scans)(scans)
    assert sound.valid.tolist() == [True, True, False]
    assert np.argwhere(~np.asarray(sound.mask)).tolist() == [[1, 2]]
    scans = scans._replace(position_m=np.zeros((3, 4, 2)), time_s=np.array([0.0, 2.0, 1.0]))
    with pytest.raises(ValueError, match=r"scans.time_s: got .*, want finite times"):
        check_scans(scans)
