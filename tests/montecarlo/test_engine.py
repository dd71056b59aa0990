"""The engine's promises inside one process: draws, equality, gradients, traces, errors."""

import itertools
import os

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from jaxtrack.montecarlo import blocks, monte_carlo

SEED = 7


def noisy_fit(key, params):
    """Least squares through noisy points: draws, a factorization, a sort, an int and a bool."""
    noise_key, place_key = jax.random.split(key)
    dtype = jnp.result_type(params["sigma"], params["slope"])
    x = jax.random.uniform(place_key, (12,), dtype)
    y = params["slope"] * x + params["sigma"] * jax.random.normal(noise_key, (12,), dtype)
    design = jnp.stack([x, jnp.exp(-x), jnp.sin(3 * x)], axis=1)
    gram = design.T @ design + 1e-2 * jnp.eye(3, dtype=dtype)
    coefficients = jax.scipy.linalg.cho_solve((jnp.linalg.cholesky(gram), True), design.T @ y)
    return {
        "coefficients": coefficients,
        "above": jnp.sum(y > 1.0),
        "first": coefficients[0] > params["slope"],
        "sorted": jnp.sort(y),
    }


def plain_loop(fn, key, trials, params):
    one = jax.jit(fn)
    results = [one(jax.random.fold_in(key, trial), params) for trial in trials]
    return jax.tree.map(lambda *leaves: np.stack(leaves), *results)


def params_of(dtype=np.float64, sigma=0.3):
    return {"sigma": jnp.asarray(sigma, dtype), "slope": jnp.asarray(2.0, dtype)}


def assert_close(got, want, tolerance):
    jax.tree.map(
        lambda a, b: np.testing.assert_allclose(a, b, rtol=tolerance, atol=tolerance), got, want
    )


def assert_equal(got, want):
    jax.tree.map(np.testing.assert_array_equal, got, want)


@pytest.mark.parametrize("trials", [1, 37, 1000])
def test_agrees_with_a_plain_loop(trials):
    key, params = jax.random.key(SEED), params_of()
    run = monte_carlo(noisy_fit, key, trials, params)
    want = plain_loop(noisy_fit, key, range(trials), params)
    assert run.values["coefficients"].shape == (trials, 3)
    assert run.values["above"].dtype == want["above"].dtype
    assert run.values["first"].dtype == np.bool_
    assert_close(run.values, want, 1e-10)
    assert (run.trials, run.micro_batch) == (trials, 32)


def test_mean_and_standard_error_are_those_of_the_values():
    run = monte_carlo(noisy_fit, jax.random.key(SEED), 137, params_of())
    want_mean = jax.tree.map(lambda leaf: leaf.mean(0), run.values)
    want_error = jax.tree.map(
        lambda leaf: np.std(leaf.astype(float), 0, ddof=1) / np.sqrt(137), run.values
    )
    assert_close(run.mean, want_mean, 1e-12)
    assert_close(run.standard_error, want_error, 1e-12)


def test_parts_are_bit_equal_to_one_run():
    key, params = jax.random.key(SEED), params_of()
    whole = monte_carlo(noisy_fit, key, 137, params).values
    parts = [
        monte_carlo(noisy_fit, key, stop - start, params, first_trial=start).values
        for start, stop in itertools.pairwise([0, 60, 61, 96, 137])
    ]
    assert_equal(jax.tree.map(lambda *leaves: np.concatenate(leaves), *parts), whole)


def test_length_of_a_block_does_not_matter(monkeypatch):
    def trial(key, params):
        return noisy_fit(key, params)

    key, params = jax.random.key(SEED), params_of()
    want = monte_carlo(noisy_fit, key, 500, params, micro_batch=8).values
    seen = []
    monkeypatch.setattr(blocks, "_BLOCK_BYTES", 1)
    run = monte_carlo(
        trial, key, 500, params, micro_batch=8, on_progress=lambda done, _: seen.append(done)
    )
    assert len(seen) == -(-500 // (8 * jax.local_device_count()))  # one micro-batch a block
    assert_equal(run.values, want)


@pytest.mark.parametrize(("dtype", "tolerance"), [(np.float64, 1e-10), (np.float32, 1e-4)])
def test_micro_batches_agree(dtype, tolerance):
    key, params = jax.random.key(SEED), params_of(dtype)
    runs = [
        monte_carlo(noisy_fit, key, 137, params, micro_batch=size).values for size in (1, 8, 32)
    ]
    assert runs[0]["coefficients"].dtype == dtype
    assert_close(runs[1], runs[0], tolerance)
    assert_close(runs[2], runs[0], tolerance)


def test_trials_up_to_the_last_32_bit_number():
    def draw(key, params):
        return jax.random.normal(key) * params

    key = jax.random.key(SEED)
    run = monte_carlo(draw, key, 40, 1.0, first_trial=2**32 - 40)
    want = plain_loop(draw, key, [np.uint32(2**32 - 40 + i) for i in range(40)], 1.0)
    np.testing.assert_allclose(run.values, want, rtol=1e-12)


def test_batched_parameters_share_the_draws():
    key = jax.random.key(SEED)
    sigmas = [0.1, 0.2, 0.5]
    batch = {"sigma": jnp.array(sigmas), "slope": jnp.full(3, 2.0)}
    run = monte_carlo(noisy_fit, key, 45, batch, batch_params=True)
    singles = [monte_carlo(noisy_fit, key, 45, params_of(sigma=sigma)) for sigma in sigmas]
    stacked = jax.tree.map(lambda *leaves: np.stack(leaves), *singles)
    assert run.values["sorted"].shape == (3, 45, 12)
    assert run.mean["sorted"].shape == (3, 12)
    assert_close(run.values, stacked.values, 1e-10)
    assert_close(run.mean, stacked.mean, 1e-10)
    assert_close(run.standard_error, stacked.standard_error, 1e-10)


def test_one_trace_for_any_values_and_any_number_of_trials():
    traces = []

    def trial(key, params):
        traces.append(1)
        return params["slope"] * jax.random.normal(key)

    for trials, sigma, seed, first in [(1, 0.1, 0, 0), (37, 0.2, 1, 5), (1000, 0.3, 2, 64)]:
        monte_carlo(trial, jax.random.key(seed), trials, params_of(sigma=sigma), first_trial=first)
    assert len(traces) == 1


def test_results_may_be_empty_arrays_tuples_and_constants():
    def trial(key, params):
        return jnp.zeros((0, 2)), (1.5, params)

    empty, (constant, given) = monte_carlo(trial, jax.random.key(0), 33, jnp.arange(3)).values
    assert empty.shape == (33, 0, 2)
    np.testing.assert_array_equal(constant, np.full(33, 1.5))
    np.testing.assert_array_equal(given, np.tile(np.arange(3), (33, 1)))


def test_a_loop_with_constant_start_and_a_random_length():
    def steps_to_leave(key, limit):
        def step(state):
            position, count = state
            return position + jax.random.normal(jax.random.fold_in(key, count)), count + 1

        return jax.lax.while_loop(lambda state: jnp.abs(state[0]) < limit, step, (0.0, 0))[1]

    key = jax.random.key(SEED)
    run = monte_carlo(steps_to_leave, key, 50, 2.0)
    np.testing.assert_array_equal(run.values, plain_loop(steps_to_leave, key, range(50), 2.0))


# Traced calls


def smooth_loss(key, params):
    fit = noisy_fit(key, params)
    return jnp.sum(fit["coefficients"] ** 2) + jnp.sum(jnp.tanh(fit["sorted"]))


@pytest.mark.parametrize(
    ("trials", "first"), [(37, 0), pytest.param(64, 5, marks=pytest.mark.slow)]
)
def test_gradient_equals_that_of_a_plain_loop_and_finite_differences(trials, first):
    key = jax.random.key(SEED)

    @jax.jit
    def mean(sigma):
        params = {"sigma": sigma, "slope": jnp.asarray(2.0)}
        return monte_carlo(smooth_loss, key, trials, params, first_trial=first).mean

    @jax.jit
    def loop_mean(sigma):
        keys = jax.vmap(jax.random.fold_in, in_axes=(None, 0))(key, first + jnp.arange(trials))
        params = {"sigma": sigma, "slope": jnp.asarray(2.0)}
        return jnp.mean(jax.vmap(smooth_loss, in_axes=(0, None))(keys, params))

    step = 1e-5
    slope = jax.jit(jax.grad(mean))(0.3)
    np.testing.assert_allclose(mean(0.3), loop_mean(0.3), rtol=1e-12)
    np.testing.assert_allclose(slope, jax.jit(jax.grad(loop_mean))(0.3), rtol=1e-10)
    np.testing.assert_allclose(slope, (mean(0.3 + step) - mean(0.3 - step)) / (2 * step), rtol=1e-6)


def test_traced_calls_agree_with_concrete_ones():
    key, params = jax.random.key(SEED), params_of()
    want = monte_carlo(noisy_fit, key, 45, params)
    got = jax.jit(lambda p: monte_carlo(noisy_fit, key, 45, p))(params)
    assert_close(got, want, 1e-12)
    # Nothing traced is passed here, but everything inside `jit` is traced.
    inside = jax.jit(lambda: monte_carlo(noisy_fit, key, 45, params).values)()
    assert_close(inside, want.values, 1e-12)
    keys = jax.random.split(key, 2)
    many = jax.jit(jax.vmap(lambda k: monte_carlo(noisy_fit, k, 45, params).mean))(keys)
    one = monte_carlo(noisy_fit, keys[1], 45, params).mean
    assert_close(jax.tree.map(lambda leaf: leaf[1], many), one, 1e-12)


def test_batched_parameters_have_gradients():
    key = jax.random.key(SEED)

    def total(sigmas):
        params = {"sigma": sigmas, "slope": jnp.full(2, 2.0)}
        return jnp.sum(monte_carlo(smooth_loss, key, 20, params, batch_params=True).mean)

    def single(sigma):
        params = {"sigma": sigma, "slope": jnp.asarray(2.0)}
        return monte_carlo(smooth_loss, key, 20, params).mean

    slope = jax.jit(jax.grad(single))
    got = jax.jit(jax.grad(total))(jnp.array([0.2, 0.6]))
    np.testing.assert_allclose(got, [slope(0.2), slope(0.6)], rtol=1e-10)


def test_backward_pass_needs_the_memory_of_one_micro_batch():
    key = jax.random.key(SEED)

    def wide(key, sigma):
        noise = jnp.sin(sigma * jax.random.normal(key, (2000,)))
        return jnp.sum(jnp.cumsum(jnp.exp(noise)) ** 2)

    def peak_bytes(trials):
        mean = jax.jit(jax.grad(lambda sigma: monte_carlo(wide, key, trials, sigma).mean))
        return mean.lower(0.5).compile().memory_analysis().temp_size_in_bytes

    assert peak_bytes(1600) < peak_bytes(64) + 1600 * 2000 * 8 // 4


def test_gradient_of_the_standard_error_is_finite_where_trials_agree():
    def error(sigma):
        return monte_carlo(lambda _, s: s * 1.0, jax.random.key(0), 8, sigma).standard_error

    assert jax.jit(jax.grad(error))(0.5) == 0.0


# Progress, warnings, errors


def test_progress_counts_up_to_the_number_of_trials():
    seen = []
    monte_carlo(
        noisy_fit,
        jax.random.key(0),
        1000,
        params_of(),
        micro_batch=8,
        first_trial=3,
        on_progress=lambda done, total: seen.append((done, total)),
    )
    done = [count for count, _ in seen]
    assert len(seen) > 2
    assert done == sorted(set(done))
    assert seen[-1] == (1000, 1000)
    assert 0 < done[0] < 1000


def test_an_interrupt_comes_through_and_does_no_harm():
    def interrupt(done, total):
        raise KeyboardInterrupt

    key, params = jax.random.key(0), params_of()
    with pytest.raises(KeyboardInterrupt):
        monte_carlo(noisy_fit, key, 1000, params, on_progress=interrupt)
    run = monte_carlo(noisy_fit, key, 37, params)
    assert_close(run.values, plain_loop(noisy_fit, key, range(37), params), 1e-10)


def test_idle_cores_are_warned_of(monkeypatch):
    def trivial(key, params):
        return params

    one_device = jax.local_devices()[:1]
    monkeypatch.setattr(jax, "local_devices", lambda: one_device)
    monkeypatch.setattr(os, "sched_getaffinity", lambda _: {0, 1, 2}, raising=False)
    with pytest.warns(UserWarning, match=r'"jax_num_cpu_devices", 3') as caught:
        monte_carlo(trivial, jax.random.key(0), 10_000, 1.0)
    assert caught[0].filename == __file__
    monte_carlo(trivial, jax.random.key(0), 9_999, 1.0)  # too short to matter
    monkeypatch.setattr(os, "sched_getaffinity", lambda _: {0}, raising=False)
    monte_carlo(trivial, jax.random.key(0), 10_000, 1.0)  # no core idle


def test_linear_algebra_that_can_stall_xla_is_warned_of(monkeypatch):
    def trial(key, params):
        points = params + jax.random.normal(key, (30, 16, 16))
        return jnp.linalg.cholesky(points @ points.mT + jnp.eye(16)[None])

    monkeypatch.setattr(os, "sched_getaffinity", lambda _: {0}, raising=False)
    monkeypatch.delenv("NPROC", raising=False)
    devices = jax.local_device_count()
    with pytest.raises(RuntimeWarning, match=f"devices: {devices}, .* NPROC={devices + 1} "):
        monte_carlo(trial, jax.random.key(0), 1, 0.0)
    run = monte_carlo(trial, jax.random.key(0), 1, 0.0, micro_batch=1)  # computed in one piece
    assert run.values.shape == (1, 30, 16, 16)
    monkeypatch.setenv("NPROC", str(devices + 1))
    program, _ = blocks._block_program(blocks.Plan(trial, 32, False), tuple(jax.local_devices()))
    jax.eval_shape(program, jax.random.key(0), 0.0, np.array([0, 0], np.uint32))  # no warning


def test_errors_say_what_is_wanted():
    def trial(key, params):
        return jax.random.normal(key)

    key = jax.random.key(0)
    legacy = jax.random.key_data(key)
    with pytest.raises(TypeError, match=r"key: got uint32\[2\], want a key from jax.random.key"):
        monte_carlo(trial, legacy, 10)
    with pytest.raises(TypeError, match=r"key: got int, want a key"):
        monte_carlo(trial, 0, 10)  # type: ignore[arg-type]
    with pytest.raises(ValueError, match=r"key: got keys of shape \[3\]"):
        monte_carlo(trial, jax.random.split(key, 3), 10)
    with pytest.raises(ValueError, match="trials: got 0"):
        monte_carlo(trial, key, 0)
    with pytest.raises(TypeError, match="trials: got float"):
        monte_carlo(trial, key, 1e5)  # type: ignore[arg-type]
    with pytest.raises(ValueError, match="micro_batch: got 0"):
        monte_carlo(trial, key, 10, micro_batch=0)
    with pytest.raises(ValueError, match="first_trial: got -1"):
        monte_carlo(trial, key, 10, first_trial=-1)
    with pytest.raises(ValueError, match="trials: got trial 4294967296 as the last"):
        monte_carlo(trial, key, 10, first_trial=2**32 - 9)
    with pytest.raises(TypeError, match="fn: got int, want a hashable callable"):
        monte_carlo(3, key, 10)  # type: ignore[arg-type]
    with pytest.raises(ValueError, match=r"params: got shapes \[2\], \[3\]"):
        monte_carlo(trial, key, 10, (jnp.zeros(2), jnp.zeros(3)), batch_params=True)
    with pytest.raises(ValueError, match="params: got shapes no leaves"):
        monte_carlo(trial, key, 10, batch_params=True)
    with pytest.raises(TypeError, match="fn: got a function that returns no array"):
        monte_carlo(lambda key, params: None, key, 10)
    with pytest.raises(TypeError, match=r"fn's result\['again'\]: got dtype key"):
        monte_carlo(lambda key, params: {"again": key}, key, 10)


def test_closing_over_traced_values_is_an_error():
    def loss(sigma):
        return monte_carlo(lambda key, _: sigma * jax.random.normal(key), jax.random.key(0), 8).mean

    with pytest.raises(TypeError, match="closes over traced values"):
        jax.grad(loss)(1.0)
