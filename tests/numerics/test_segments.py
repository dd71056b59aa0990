"""A scan in segments is a scan: values, gradients, memory, and what is not done twice."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from jaxtrack.numerics import costly, decided, scan_in_segments
from tests.metrics.differences import assert_gradients_agree

SIZE = 6


def walk(state, look):
    """Return a state that depends on what a sort decides, and two infos."""
    x, turns = state
    order = decided(jnp.argsort(jax.lax.stop_gradient(x + look)))
    x = jnp.tanh(costly(jnp.cos(x + 0.1 * look)))[order] + 0.5 * look
    return (x, turns + 1), {"x": x, "order": order}


def loss(scan, start, looks):
    (last, _), infos = scan(walk, (start, jnp.zeros((), jnp.int32)), looks)
    return (infos["x"] ** 2).mean() + last.sum()


def case(looks, seed=0):
    rng = np.random.default_rng(seed)
    return rng.normal(size=SIZE), rng.normal(size=(looks, SIZE))


@pytest.mark.parametrize("looks", [0, 1, 7, 12, 31])
def test_it_is_the_scan_bit_for_bit(looks):
    start, xs = case(looks)
    run = lambda scan: jax.jit(lambda *at: scan(walk, (at[0], jnp.zeros((), jnp.int32)), at[1]))
    got, expected = (run(scan)(start, xs) for scan in (scan_in_segments, jax.lax.scan))
    jax.tree.map(np.testing.assert_array_equal, got, expected)
    assert got[1]["x"].shape == (looks, SIZE)


@pytest.mark.parametrize("looks", [1, 7, 12, 31])
def test_its_gradients_are_the_scan_s(looks):
    at = case(looks)
    got, expected = (
        jax.jit(jax.grad(lambda *at, scan=scan: loss(scan, *at), (0, 1)))(*at)
        for scan in (scan_in_segments, jax.lax.scan)
    )
    for one, other in zip(got, expected, strict=True):
        np.testing.assert_allclose(one, other, rtol=1e-12, atol=1e-14)


def test_jitted_gradients_equal_differences():
    of = jax.jit(lambda *at: loss(scan_in_segments, *at))
    assert_gradients_agree(of, *case(12), rtol=1e-5, atol=1e-8)


def count(jaxpr, name):
    """Return how often a primitive stands in a program and all programs inside it."""
    inner = [
        part.jaxpr if hasattr(part, "jaxpr") else part
        for equation in jaxpr.eqns
        for value in equation.params.values()
        for part in (value if isinstance(value, tuple | list) else (value,))
        if hasattr(part, "jaxpr") or hasattr(part, "eqns")
    ]
    here = sum(equation.primitive.name == name for equation in jaxpr.eqns)
    return here + sum(count(one, name) for one in inner)


def test_what_is_decided_is_decided_once_and_what_is_costly_twice():
    back = jax.make_jaxpr(jax.grad(lambda *at: loss(scan_in_segments, *at), (0, 1)))(*case(12))
    assert count(back.jaxpr, "sort") == 1
    assert count(back.jaxpr, "cos") == 2


def test_the_gradient_keeps_few_states():
    start, looks = case(1)[0], np.linspace(0.0, 1.0, 400)
    wave = lambda x, look: (jnp.sin(jnp.tanh(x) * jnp.exp(x)) + look, None)

    def needed(scan):
        back = jax.grad(lambda *at: scan(wave, *at)[0].sum())
        return jax.jit(back).lower(start, looks).compile().memory_analysis().temp_size_in_bytes

    states = 20 + 20
    assert needed(scan_in_segments) < 2 * states * start.nbytes + 10_000
    assert needed(jax.lax.scan) > 400 * start.nbytes + 10_000


def test_single_precision_stays_single():
    start, xs = (np.float32(x) for x in case(12))
    (last, _), infos = scan_in_segments(walk, (start, jnp.zeros((), jnp.int32)), xs)
    assert last.dtype == infos["x"].dtype == np.float32
