import jax
import jax.numpy as jnp
import numpy as np
import pytest

from jaxtrack import numerics

SCALARS = {
    "identity": (numerics.identity(), [-3.0, 0.0, 7.5]),
    "positive": (numerics.positive(), [1e-12, 0.3, 1.0, 40.0, 1e12]),
    "bounded": (numerics.bounded(-2.0, 5.0), [-1.999, 0.0, 1.5, 4.999]),
    "bounded by arrays": (numerics.bounded(jnp.array(0.0), jnp.array(1.0)), [1e-9, 0.5, 0.999]),
}
EXTREME = [-1e300, -1e4, -800.0, -40.0, 0.0, 40.0, 800.0, 1e4, 1e300]


@pytest.mark.parametrize("name", SCALARS)
def test_round_trip_from_the_constrained_side(name):
    bijector, inside = SCALARS[name]
    atol = 1e-15 if name == "bounded" else 0.0  # only there 0 is in the middle of the range
    forward, inverse = jax.jit(jax.vmap(bijector.forward)), jax.jit(jax.vmap(bijector.inverse))
    np.testing.assert_allclose(forward(inverse(jnp.array(inside))), inside, rtol=1e-12, atol=atol)


@pytest.mark.parametrize("name", SCALARS)
def test_round_trip_from_the_unconstrained_side(name):
    bijector, _ = SCALARS[name]
    free = jnp.linspace(-8.0, 8.0, 33)
    np.testing.assert_allclose(bijector.inverse(bijector.forward(free)), free, atol=1e-11)


@pytest.mark.parametrize("name", SCALARS)
def test_values_and_gradients_stay_finite_at_extremes(name):
    forward = SCALARS[name][0].forward
    value, gradient = jax.jit(jax.vmap(jax.value_and_grad(forward)))(jnp.array(EXTREME))
    assert jnp.isfinite(value).all()
    assert jnp.isfinite(gradient).all()
    assert (gradient >= 0).all()


@pytest.mark.parametrize("name", SCALARS)
def test_jitted_gradient_agrees_with_central_differences(name):
    bijector, _ = SCALARS[name]
    free = np.linspace(-4.0, 4.0, 9)
    slope = jax.jit(jax.vmap(jax.grad(bijector.forward)))(free)
    expected = (bijector.forward(free + 1e-6) - bijector.forward(free - 1e-6)) / 2e-6
    np.testing.assert_allclose(slope, expected, rtol=1e-6)


@pytest.mark.parametrize("dtype", [np.float32, np.float64])
def test_positive_is_the_exponential_and_its_square_is_a_finite_number(dtype):
    forward = jax.jit(numerics.positive().forward)
    np.testing.assert_allclose(forward(dtype(-1.5)), np.exp(dtype(-1.5)), rtol=1e-6)
    for u in (dtype(-1e30), dtype(1e30)):
        value = forward(u)
        assert value.dtype == dtype
        assert value > 0
        assert np.isfinite(value * value)
        assert value * value > 0


def test_positive_inverse_of_nothing_is_finite():
    inverse = jax.jit(jax.value_and_grad(numerics.positive().inverse))
    for y in (0.0, -1.0, 1e-300):
        value, gradient = inverse(y)
        assert np.isfinite(value)
        assert gradient == 0


@pytest.mark.parametrize("dtype", [np.float32, np.float64])
def test_bounded_meets_its_bounds_and_inverts_them_to_finite_numbers(dtype):
    low, high = 0.1, 0.7
    bijector = numerics.bounded(low, high)
    assert bijector.forward(dtype(-1e30)) == dtype(low)
    assert bijector.forward(dtype(1e30)) == dtype(high)
    for bound in (dtype(low), dtype(high)):
        free, slope = jax.jit(jax.value_and_grad(bijector.inverse))(bound)
        assert np.isfinite(free)
        assert np.isfinite(slope)
        np.testing.assert_allclose(bijector.forward(free), bound, rtol=1e-6)


def test_simplex_round_trips():
    bijector = numerics.simplex()
    rng = np.random.default_rng(10)
    for probability in rng.dirichlet(np.full(4, 0.5), size=10):
        free = jax.jit(bijector.inverse)(probability)
        assert free.shape == (3,)
        np.testing.assert_allclose(jax.jit(bijector.forward)(free), probability, rtol=1e-12)
    free = rng.normal(size=(10, 3)) * 5
    back = jax.vmap(bijector.inverse)(jax.vmap(bijector.forward)(free))
    np.testing.assert_allclose(back, free, atol=1e-11)


def test_simplex_has_positive_entries_of_sum_one():
    probability = numerics.simplex().forward(jnp.array([2.0, -1.0], dtype=jnp.float32))
    assert probability.dtype == jnp.float32
    assert (probability > 0).all()
    np.testing.assert_allclose(probability.sum(), 1.0, rtol=1e-6)
    assert numerics.simplex().forward(jnp.zeros(0)).tolist() == [1.0]


@pytest.mark.parametrize("u", [[1e300, -1e300], [1e4, 1e4], [-1e4, -1e4], [0.3, -0.8]])
def test_simplex_gradients(u):
    forward = numerics.simplex().forward
    jacobian = jax.jit(jax.jacrev(forward))(jnp.array(u))
    p = np.asarray(forward(jnp.array(u)))
    np.testing.assert_allclose(jacobian, (np.diag(p) - np.outer(p, p))[:, :2], atol=1e-14)


def test_simplex_inverse_at_a_corner_is_finite():
    value, slope = jax.jit(
        lambda p: (numerics.simplex().inverse(p), jax.jacrev(numerics.simplex().inverse)(p))
    )(jnp.array([1.0, 0.0, 0.0]))
    assert jnp.isfinite(value).all()
    assert jnp.isfinite(slope).all()


def test_simplex_wants_one_axis():
    with pytest.raises(ValueError, match=r"u: got shape \[2, 3\], want \[n - 1\]"):
        numerics.simplex().forward(jnp.zeros((2, 3)))


def test_a_tree_of_bijectors_is_a_bijector_of_trees():
    both = numerics.bijector_of(
        {"gate": numerics.identity(), "shares": numerics.simplex(), "noise": numerics.positive()}
    )
    noise = (jnp.array(2.0), jnp.array([3.0, 0.1]))  # one bijector for all that is below
    params = {"gate": jnp.array(-4.0), "shares": jnp.array([0.2, 0.8]), "noise": noise}
    free = jax.jit(both.inverse)(params)
    assert free["shares"].shape == (1,)
    np.testing.assert_allclose(free["noise"][1], np.log([3.0, 0.1]))
    back = jax.jit(both.forward)(free)
    assert jax.tree.structure(back) == jax.tree.structure(params)
    jax.tree.map(lambda x, y: np.testing.assert_allclose(x, y, rtol=1e-14), back, params)


def test_what_is_no_tree_of_bijectors_is_refused():
    with pytest.raises(TypeError, match="bijectors: got float, want a pytree of Bijector"):
        numerics.bijector_of({"gate": 1.0})
    with pytest.raises(
        ValueError, match=r"bijectors: got .*'gate'.*, want ones that fit .*'noise'"
    ):
        numerics.bijector_of({"gate": numerics.identity()}).inverse({"noise": 1.0})
