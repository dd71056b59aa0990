import jax
import jax.numpy as jnp
import numpy as np
import pytest

from jaxtrack import numerics

DTYPES = [np.float32, np.float64]


def central_differences(loss, x, step=1e-6):
    x = np.asarray(x, dtype=np.float64)
    gradient = np.zeros_like(x)
    for index in np.ndindex(x.shape):
        ahead, behind = x.copy(), x.copy()
        ahead[index] += step
        behind[index] -= step
        gradient[index] = (float(loss(ahead)) - float(loss(behind))) / (2 * step)
    return gradient


SINGULAR = {
    "sqrt at 0": (numerics.safe_sqrt, 0.0, 0.0),
    "sqrt below 0": (numerics.safe_sqrt, -1.0, 0.0),
    "norm at 0": (numerics.safe_norm, [0.0, 0.0, 0.0], 0.0),
    "divide by 0": (lambda d: numerics.safe_divide(jnp.ones_like(d), d, 5.0), 0.0, 5.0),
    "0 divided by 0": (lambda x: numerics.safe_divide(x, x), 0.0, 0.0),
    "arctan2 at 0": (lambda v: numerics.safe_arctan2(v[0], v[1]), [0.0, 0.0], 0.0),
    "arctan2 near 0": (lambda v: numerics.safe_arctan2(v[0], v[1]), [1e-30, -1e-170], 0.0),
    "floored log": (lambda x: numerics.safe_log(x, floor=np.float32(0.25)), 0.1, np.log(0.25)),
}


@pytest.mark.parametrize("dtype", DTYPES)
@pytest.mark.parametrize("case", SINGULAR)
def test_singular_point_has_the_stated_value_and_gradient_zero(case, dtype):
    function, at, value = SINGULAR[case]
    if case == "arctan2 near 0" and dtype == np.float64:
        at = [1e-160, -1e-170]
    got, gradient = jax.jit(jax.value_and_grad(function))(jnp.asarray(at, dtype=dtype))
    assert got.dtype == dtype
    np.testing.assert_allclose(got, value, rtol=1e-6)
    np.testing.assert_array_equal(gradient, np.zeros(np.shape(at)))


@pytest.mark.parametrize("dtype", DTYPES)
@pytest.mark.parametrize("x", [0.0, -3.0, -np.inf])
def test_log_of_nothing_is_the_log_of_the_smallest_normal_number(x, dtype):
    value, gradient = jax.jit(jax.value_and_grad(numerics.safe_log))(jnp.asarray(x, dtype=dtype))
    np.testing.assert_allclose(value, np.log(np.finfo(dtype).tiny), rtol=1e-6)
    assert gradient == 0


REGULAR = {
    "sqrt": (lambda v: numerics.safe_sqrt(v).sum(), lambda v: np.sqrt(v).sum()),
    "norm": (numerics.safe_norm, np.linalg.norm),
    "divide": (lambda v: numerics.safe_divide(v[0], v[1]), lambda v: v[0] / v[1]),
    "log": (lambda v: numerics.safe_log(v).sum(), lambda v: np.log(v).sum()),
    "arctan2": (lambda v: numerics.safe_arctan2(-v[0], v[1]), lambda v: np.arctan2(-v[0], v[1])),
    "min": (numerics.safe_min, np.min),
    "max": (numerics.safe_max, np.max),
}


@pytest.mark.parametrize("case", REGULAR)
def test_regular_point_agrees_with_numpy_in_value_and_gradient(case):
    function, oracle = REGULAR[case]
    x = np.array([0.7, 1.9, 0.4])
    value, gradient = jax.jit(jax.value_and_grad(function))(jnp.asarray(x))
    np.testing.assert_allclose(value, oracle(x), rtol=1e-14)
    np.testing.assert_allclose(gradient, central_differences(oracle, x), rtol=1e-6, atol=1e-9)


@pytest.mark.parametrize(
    "function", [numerics.safe_sqrt, numerics.safe_log, numerics.wrap_angle, numerics.safe_norm]
)
def test_nan_is_not_hidden(function):
    assert jnp.isnan(function(jnp.array([jnp.nan]))).all()


def test_divide_keeps_gradients_finite_beside_a_zero_denominator():
    def total(numerator, denominator):
        return numerics.safe_divide(numerator, denominator).sum()

    top, bottom = jnp.array([1.0, jnp.inf, jnp.nan]), jnp.array([2.0, 0.0, 0.0])
    by_top, by_bottom = jax.jit(jax.grad(total, argnums=(0, 1)))(top, bottom)
    np.testing.assert_allclose(by_top, [0.5, 0.0, 0.0])
    np.testing.assert_allclose(by_bottom, [-0.25, 0.0, 0.0])


def test_integers_are_taken_as_floats():
    assert float(numerics.safe_norm(jnp.array([3, 4]))) == 5.0
    assert float(numerics.safe_divide(1, 4)) == 0.25


def test_python_scalars_leave_the_other_dtype_alone():
    assert numerics.safe_divide(jnp.float32(1), 4).dtype == jnp.float32
    assert numerics.safe_divide(1, jnp.float32(4), fallback=2).dtype == jnp.float32


@pytest.mark.parametrize("axis", [0, 1, -1])
def test_extremes_along_any_axis(axis):
    x = np.random.default_rng(1).normal(size=(4, 3))
    np.testing.assert_array_equal(numerics.safe_min(jnp.asarray(x), axis), x.min(axis))
    np.testing.assert_array_equal(numerics.safe_max(jnp.asarray(x), axis), x.max(axis))


def test_first_of_equals_takes_the_whole_gradient():
    x = jnp.array([[3.0, 1.0, 1.0], [2.0, 2.0, 0.0]])
    lowest = jax.jit(jax.grad(lambda x: numerics.safe_min(x).sum()))(x)
    highest = jax.jit(jax.grad(lambda x: numerics.safe_max(x).sum()))(x)
    np.testing.assert_array_equal(lowest, [[0, 1, 0], [0, 0, 1]])
    np.testing.assert_array_equal(highest, [[1, 0, 0], [1, 0, 0]])


@pytest.mark.parametrize(
    ("reduce", "on_diagonal"), [(numerics.safe_min, 1e3), (numerics.safe_max, 0)]
)
def test_jitted_gradient_through_extremes_is_right(reduce, on_diagonal):
    """Jitted gradients through plain `min` and `max` have been seen finite and wrong."""

    def loss(points):
        difference = points[:, None, :] - points[None, :, :]
        same = jnp.eye(points.shape[0], dtype=bool)
        square = jnp.where(same, float(on_diagonal), jnp.sum(difference**2, axis=-1))
        extreme = reduce(square, -1)
        weight = jnp.exp(-(square / (1.0 + extreme[:, None])))
        return jnp.sum(weight @ jnp.sin(points) * points) / jnp.sum(weight + 0.1)

    jitted, gradient_of = jax.jit(loss), jax.jit(jax.grad(loss))
    for seed in range(20):
        points = np.random.default_rng(seed).normal(size=(6, 2))
        gradient = gradient_of(jnp.asarray(points))
        expected = central_differences(jitted, points)
        np.testing.assert_allclose(gradient, expected, rtol=1e-6, atol=1e-8)


@pytest.mark.parametrize("dtype", DTYPES)
def test_wrapped_angles_lie_in_the_half_open_interval(dtype):
    pi = dtype(np.pi)
    edges = [k * pi for k in range(-9, 10)]
    edges += [np.nextafter(e, dtype(s)) for e in edges for s in (-np.inf, np.inf)]
    random = np.random.default_rng(2).uniform(-50, 50, size=500).astype(dtype)
    angles = np.concatenate([np.array(edges, dtype=dtype), random])
    wrapped = np.asarray(jax.jit(numerics.wrap_angle)(angles))
    assert wrapped.dtype == dtype
    assert (wrapped >= -pi).all()
    assert (wrapped < pi).all()
    tolerance = 100 * np.finfo(dtype).eps
    np.testing.assert_allclose(np.cos(wrapped), np.cos(angles), atol=tolerance)
    np.testing.assert_allclose(np.sin(wrapped), np.sin(angles), atol=tolerance)


def test_wrapping_keeps_small_angles_bit_for_bit_and_has_gradient_one():
    assert float(numerics.wrap_angle(jnp.float32(1e-9))) == np.float32(1e-9)
    angles = jnp.array([-40.0, -np.pi, -1e-20, 0.0, np.pi, 7.0])
    slope = jax.jit(jax.grad(lambda a: numerics.wrap_angle(a).sum()))(angles)
    np.testing.assert_array_equal(slope, np.ones(6))


@pytest.mark.parametrize("dtype", DTYPES)
def test_sinc_and_its_slope_keep_their_precision_near_zero(dtype):
    x = np.concatenate([[0.0], 10.0 ** np.arange(-8.0, 1.0), [0.4999, 0.5001, 3.0, 40.0]])
    x = np.concatenate([x, -x]).astype(dtype)
    wide = x.astype(np.longdouble)
    term, value, slope = np.ones_like(wide), np.ones_like(wide), np.zeros_like(wide)
    for k in range(2, 40, 2):  # the series, in more digits than either dtype has
        term = term * -wide * wide / (k * (k + 1))
        value, slope = value + term, slope + k * term / np.where(wide == 0, 1, wide)
    near = np.abs(x) < 5
    got = np.asarray(jax.jit(numerics.safe_sinc)(x))
    steep = np.asarray(jax.jit(jax.grad(lambda x: numerics.safe_sinc(x).sum()))(x))
    assert got.dtype == steep.dtype == dtype
    eps = np.finfo(dtype).eps
    np.testing.assert_allclose(got[near], value[near].astype(float), rtol=4 * eps)
    np.testing.assert_allclose(steep[near], slope[near].astype(float), rtol=40 * eps)
    np.testing.assert_allclose(got[~near], np.sin(x[~near]) / x[~near], rtol=4 * eps)
