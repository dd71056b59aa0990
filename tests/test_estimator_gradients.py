"""Gradients of whole estimators, all asked what `test_gradients` asks of parts.

Compiled ones equal differences at smooth points, are finite on ten thousand random and degenerate
inputs, and in single precision are those of double to a hundredth. Estimators choose: which cells
are strongest, whether there is a track. Where a choice tips, no gradient is right; so a point is
smooth where differences to one side agree with those to the other, whatever the gradient is.
"""

import functools

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from tests.estimator_cases import CASES, Inputs, degenerate, draw, loss

CHUNK = 128  # realizations at a time, so that one program does for all
POINTS, ENTRIES = 16, 48  # of each case; and of the gradient at each, at most
STEP = 1e-4
QUICK = ("modified", "initiate", "particles, transport")


@pytest.fixture(autouse=True)
def _draws_are_alike_in_both_precisions(monkeypatch):
    for name in ("normal", "uniform"):
        of = getattr(jax.random, name)

        def single(key, shape=(), dtype=float, *args, of=of, **named):
            found = of(key, shape, jnp.float32, *args, **named)
            return found.astype(dtype) if dtype is not float else found.astype(jnp.result_type(0.0))

        monkeypatch.setattr(jax.random, name, single)


@functools.cache
def compiled(name):
    def of(inputs):
        arguments = inputs[:3]
        return jax.value_and_grad(functools.partial(loss, name), argnums=(0, 1, 2))(
            *arguments, inputs
        )

    return jax.jit(jax.vmap(of))


def evaluated(name, inputs, dtype: type[np.floating] = np.float64):
    """Return values [n] and gradients, flat and side by side, [n, D]."""
    cast = lambda x: x.astype(dtype) if x.dtype == np.float64 else x
    count = len(inputs.seed)
    values, slopes = [], []
    for start in range(0, count, CHUNK):
        at = np.minimum(np.arange(start, start + CHUNK), count - 1)
        value, gradient = compiled(name)(Inputs(*(cast(x[at]) for x in inputs)))
        assert value.dtype == dtype
        assert all(g.dtype == dtype for g in gradient)
        values.append(np.asarray(value))
        slopes.append(np.concatenate([np.asarray(g).reshape(CHUNK, -1) for g in gradient], axis=1))
    return np.concatenate(values)[:count], np.concatenate(slopes)[:count]


def moved(one, entry, by):
    """Return one realization many times, an entry [n] of what is differentiated moved [n]."""
    count = len(entry)
    flat = [np.repeat(x.reshape(1, -1), count, axis=0) for x in one[:3]]
    together = np.concatenate(flat, axis=1)
    together[np.arange(count), entry] += by
    ends = np.cumsum([x.shape[1] for x in flat])[:-1]
    parts = np.split(together, ends, axis=1)
    shaped = [x.reshape(count, *of.shape) for x, of in zip(parts, one[:3], strict=True)]
    return Inputs(*shaped, *(np.repeat(np.asarray(x)[None], count, axis=0) for x in one[3:]))


def differences(name, one, entry):
    """Return slopes of the fourth order [n], and whether those of three other points agree."""
    at = moved(one, np.repeat(entry, 5), np.tile(STEP * np.arange(-2, 3), len(entry)))
    a, b, c, d, e = evaluated(name, at)[0].reshape(-1, 5).T / STEP
    both = (a - 8 * b + 8 * d - e) / 12
    others = (d - b) / 2, (-3 * c + 4 * d - e) / 2, (3 * c - 4 * b + a) / 2
    # A fifth of what the gradient is asked for: a bend may hide from one of them in part.
    near = [np.abs(x - both) <= allowed(both) / 5 for x in others]
    return both, np.all(near)


def allowed(slopes):
    return 1e-5 * np.abs(slopes) + 1e-6 * np.abs(slopes).max()


@functools.cache
def smooth_points(name):
    """Return points, gradients, which points are smooth, and entries and differences at each."""
    rng = np.random.default_rng(7)
    points = draw(name, rng, POINTS)
    _, gradients = evaluated(name, points)
    smooth, entries, central = [], [], []
    for n in range(POINTS):
        one = Inputs(*(x[n] for x in points))
        counts = np.broadcast_to((one.mask & one.valid[:, None])[..., None], one.position.shape)
        count = len(one.number)
        some = np.flatnonzero(np.concatenate([counts.ravel(), counts[..., 0].ravel()]))
        some = rng.permutation(some)[: ENTRIES - count]
        entry = np.concatenate([some, counts.size * 3 // 2 + np.arange(count)])
        slopes, agree = differences(name, one, entry)
        smooth.append(agree)
        entries.append(entry)
        central.append(slopes)
    return points, gradients, np.array(smooth), entries, central


def every_case_but(**broken):
    """Parametrize by all cases; those that are known to fail say how."""
    known = lambda name: [pytest.mark.xfail(reason=broken[name])] if name in broken else []
    return pytest.mark.parametrize("name", [pytest.param(n, marks=known(n)) for n in CASES])


EXTREME = "at some of the extreme inputs a gradient is not finite"


@pytest.mark.slow
@pytest.mark.parametrize("name", CASES)
def test_jitted_gradients_equal_differences_at_smooth_points(name):
    if CASES[name].differs:
        pytest.skip(CASES[name].differs)
    _, gradients, smooth, entries, central = smooth_points(name)
    assert smooth.mean() >= 0.5
    for n in np.flatnonzero(smooth):
        got = gradients[n, entries[n]]
        assert np.abs(got).max() > 1e-3
        assert (np.abs(got - central[n]) <= allowed(central[n])).all()


@pytest.mark.slow
@every_case_but(initiate="recursive least squares lose digits where they forget")
def test_single_precision_is_within_a_hundredth_at_smooth_points(name):
    points, gradients, smooth, _, _ = smooth_points(name)
    some = Inputs(*(x[smooth] for x in points))
    _, got = evaluated(name, some, np.float32)
    off = np.linalg.norm(got - gradients[smooth], axis=1)
    assert (off <= 1e-2 * np.linalg.norm(gradients[smooth], axis=1)).all()


def assert_finite(name, count, dtype):
    rng = np.random.default_rng(11)
    plain = draw(name, rng, count)
    most = 1e4 if dtype == np.float64 else 1e2
    special = degenerate(name, rng, plain, most)
    some = rng.random(count) < 0.2
    pick = lambda x, y: np.where(some.reshape(-1, *(1,) * (x.ndim - 1)), x, y)
    inputs = Inputs(*map(pick, plain, special))
    value, slopes = evaluated(name, inputs, dtype)
    bad = ~(np.isfinite(value) & np.isfinite(slopes).all(1))
    first = Inputs(*(x[bad.argmax()] for x in inputs)) if bad.any() else None
    assert not bad.any(), f"{bad.sum()} times, first at {first}"


@pytest.mark.parametrize("name", QUICK)
def test_gradients_are_finite_on_hundreds_of_inputs(name):
    assert_finite(name, 2 * CHUNK, np.float64)


@pytest.mark.slow
@every_case_but(**dict.fromkeys(["joint", "joint, beams", "tracker, polar"], EXTREME))
@pytest.mark.parametrize("dtype", [np.float64, np.float32])
def test_gradients_are_finite_on_ten_thousand_inputs(name, dtype):
    assert_finite(name, 10_000, dtype)
