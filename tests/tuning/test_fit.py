"""The training loop: where it arrives, what it keeps, and that it goes on bit for bit."""

import functools

import jax
import jax.numpy as jnp
import numpy as np
import optax
import pytest

from jaxtrack.numerics import bounded, identity, positive, simplex
from jaxtrack.tuning import checkpoint, fit
from jaxtrack.tuning.checkpoint import FILE

KEY = jax.random.key(3)
FEW = {"key": KEY, "steps": 25, "batch": 8, "holdout": 24, "every": 10}


def noisy(params, key):
    """A bowl whose middle moves with the realization; its mean is least at 5 and (.2, .3, .5)."""
    noise = jax.random.normal(key, (4,)) * 0.1
    scale = (jnp.log(params["scale"] / 5.0) - noise[0]) ** 2
    return scale + ((params["shares"] - jnp.array([0.2, 0.3, 0.5]) - noise[1:]) ** 2).sum()


START = {"scale": 0.5, "shares": jnp.full(3, 1 / 3)}
BIJECTORS = {"scale": positive(), "shares": simplex()}


def run(loss=noisy, params=START, optimizer=None, bijectors=BIJECTORS, **changes):
    optimizer = optax.adam(0.2) if optimizer is None else optimizer
    return fit(loss, params, optimizer, bijectors=bijectors, **FEW | changes)


def same(one, other):
    assert jax.tree.structure(one) == jax.tree.structure(other)
    jax.tree.map(np.testing.assert_array_equal, one, other)


@functools.cache
def whole():
    return run(steps=80)


def test_it_arrives_and_says_how():
    result = whole()
    np.testing.assert_allclose(result.params["scale"], 5.0, rtol=0.05)
    np.testing.assert_allclose(result.params["shares"], [0.2, 0.3, 0.5], atol=0.05)
    np.testing.assert_allclose(result.params["shares"].sum(), 1.0, rtol=1e-12)
    history = result.history
    assert history.loss.shape == history.loss_error.shape == history.grad_norm.shape == (80,)
    assert history.params["shares"].shape == (81, 3)
    assert history.evaluated.tolist() == list(range(0, 81, 10))
    assert history.realizations.tolist() == [8 * s + 24 * (n + 1) for n, s in
                                             enumerate(range(0, 81, 10))]  # fmt: skip
    assert history.finite.all()
    assert not result.stopped_early
    assert result.held_out == history.held_out.min() < history.held_out[0] / 10
    at = int(np.argmin(history.held_out))
    assert result.best_step == history.evaluated[at]
    assert result.held_out_error == history.held_out_error[at] > 0
    same(jax.device_get(result.params), jax.tree.map(lambda x: x[result.best_step], history.params))


def test_the_first_step_is_the_optimizer_s_on_the_mean_gradient_of_the_batch():
    result = run(optimizer=optax.sgd(0.1), steps=1)
    keys = [jax.random.fold_in(jax.random.fold_in(jax.random.fold_in(KEY, 0), 1), trial)
            for trial in range(8)]  # fmt: skip

    def mean(u):
        params = {"scale": jnp.exp(u["scale"]), "shares": simplex().forward(u["shares"])}
        return jnp.stack([noisy(params, key) for key in keys]).mean()

    free = {"scale": jnp.log(0.5), "shares": jnp.zeros(2)}
    loss, slope = jax.jit(jax.value_and_grad(mean))(free)
    np.testing.assert_allclose(result.history.loss[0], loss, rtol=1e-12)
    np.testing.assert_allclose(result.history.grad_norm[0], optax.tree.norm(slope), rtol=1e-12)
    moved = np.exp(free["scale"] - 0.1 * slope["scale"])
    np.testing.assert_allclose(result.history.params["scale"][1], moved, rtol=1e-12)
    shares = simplex().forward(free["shares"] - 0.1 * slope["shares"])
    np.testing.assert_allclose(result.history.params["shares"][1], shares, rtol=1e-12)


def test_common_random_numbers_are_the_same_every_step_and_fresh_ones_are_not():
    still = functools.partial(run, optimizer=optax.sgd(0.0), steps=4)
    assert len(set(still(fresh=False).history.loss.tolist())) == 1
    assert len(set(still(fresh=True).history.loss.tolist())) == 4
    assert len(set(still().history.held_out.tolist())) == 1


def test_clipping_bounds_the_step_and_not_the_norm_that_is_reported():
    result = run(optimizer=optax.sgd(1.0), clip=1e-3, steps=3)
    assert (result.history.grad_norm > 1e-2).all()
    moved = np.diff(np.log(result.history.params["scale"]))
    assert (np.abs(moved) <= 1e-3 + 1e-12).all()
    unclipped = run(optimizer=optax.sgd(0.1), clip=1e6, steps=3)
    same(unclipped, run(optimizer=optax.sgd(0.1), steps=3))


def goes_on_bit_for_bit(folder, cut, run):
    class Stop(Exception):
        pass

    def stop(done, steps):
        if done == cut:
            raise Stop

    expected = run()
    with pytest.raises(Stop):
        run(checkpoint=folder, progress=stop)
    seen = []
    same(run(checkpoint=folder, progress=lambda *at: seen.append(at)), expected)
    assert seen[0] == (cut - cut % 10 + 1, 25)
    same(run(checkpoint=folder), expected)


@pytest.mark.parametrize("cut", [10, 13, 20])
def test_an_interrupted_run_goes_on_bit_for_bit(tmp_path, cut):
    goes_on_bit_for_bit(tmp_path, cut, run)


def test_a_finished_run_can_be_made_longer(tmp_path):
    run(checkpoint=tmp_path)
    same(run(checkpoint=tmp_path, steps=40), run(steps=40))


@pytest.mark.parametrize(
    "change",
    [
        {"key": jax.random.key(4)},
        {"batch": 4},
        {"params": START | {"scale": 0.6}},
        {"optimizer": optax.sgd(0.1)},
        {"clip": 1.0},
    ],
)
def test_another_fit_s_checkpoint_is_refused(tmp_path, change):
    run(checkpoint=tmp_path, steps=1)
    with pytest.raises(ValueError, match=f"checkpoint: got .*{FILE} of another fit"):
        run(checkpoint=tmp_path, steps=1, **change)


def test_a_write_that_died_leaves_the_one_before(tmp_path):
    run(checkpoint=tmp_path)
    (tmp_path / f"half_{FILE}").write_bytes(b"broken")
    same(run(checkpoint=tmp_path), run())


def test_optimizers_that_draw_noise_go_on_too(tmp_path):
    make = lambda: optax.noisy_sgd(0.1, key=jax.random.key(0))
    run(checkpoint=tmp_path, optimizer=make(), steps=10)
    same(run(checkpoint=tmp_path, optimizer=make()), run(optimizer=make()))


def test_it_stops_when_the_held_out_loss_gets_no_better():
    result = run(optimizer=optax.sgd(0.0), steps=100, patience=2)
    assert result.stopped_early
    assert result.history.evaluated.tolist() == [0, 10, 20]
    assert not run(optimizer=optax.sgd(0.0), steps=20, patience=2).stopped_early
    assert result.best_step == 0


def test_held_out_realizations_choose_the_best_step_not_the_last():
    uphill = lambda count: jnp.where(count < 20, 0.5, -0.5)
    result = run(optimizer=optax.sgd(uphill), steps=40)
    assert 0 < result.best_step < 40
    assert result.history.held_out[-1] > result.held_out


def broken(params, key):
    """A loss with a hole that steps lead into."""
    distance = params["x"] - 1.0
    return jnp.where(params["x"] > 0.5, jnp.nan, distance**2) + 0.0 * jax.random.normal(key)


def test_a_step_that_is_not_finite_is_left_out_and_marked_and_there_is_a_warning():
    with pytest.warns(RuntimeWarning, match="fit: 4 of 5 steps were left out"):
        result = run(broken, {"x": 0.3}, optax.sgd(0.2), None, steps=5)
    history = result.history
    assert history.finite.tolist() == [True, False, False, False, False]
    assert np.isfinite(history.params["x"]).all()
    assert history.params["x"][1] == history.params["x"][5] > 0.5
    assert result.params["x"] == 0.3
    with pytest.raises(ValueError, match="loss: got a mean of nan at the start"):
        run(broken, {"x": 0.7}, optax.sgd(0.2), None, steps=5)


@pytest.mark.parametrize("fresh", [True, False])
def test_a_fit_without_a_step_is_an_error(fresh):
    def no_slope(params, key):
        return jnp.abs(params["x"]) ** 0.5 + 0.0 * jax.random.normal(key)

    message = "loss: got 0.0 and a gradient of norm (nan|inf), as in all 10 steps, want finite ones"
    with pytest.raises(ValueError, match=message):
        run(no_slope, {"x": 0.0}, bijectors=None, fresh=fresh)


def test_a_change_that_is_not_finite_is_left_out_too():
    wild = optax.sgd(lambda count: jnp.where(count == 1, jnp.nan, 0.1))
    with pytest.warns(RuntimeWarning, match="fit: 2 of 3 steps were left out"):
        result = run(optimizer=wild, steps=3)
    assert result.history.finite.tolist() == [True, False, False]
    assert np.isfinite(result.history.params["shares"]).all()


@pytest.mark.parametrize(
    "optimizer",
    [optax.rmsprop(0.05), optax.lion(0.05), optax.adamw(0.1),
     optax.chain(optax.clip(1.0), optax.sgd(optax.cosine_decay_schedule(0.3, 60), momentum=0.5))],
)  # fmt: skip
def test_any_optimizer_will_do(optimizer):
    result = run(optimizer=optimizer, steps=60)
    assert result.held_out < result.history.held_out[0] / 3


def test_bounds_hold_and_dtypes_stay():
    def loss(params, key):
        return (params[0] - 9.0) ** 2 + (params[1] * jax.random.normal(key, dtype=jnp.float32)) ** 2

    start = jnp.float32(1.0), jnp.float32(2.0)
    result = run(loss, start, optax.adam(0.5), (bounded(0.0, 2.0), identity()), steps=40)
    assert all(x.dtype == np.float32 for x in jax.tree.leaves(result.params))
    assert 1.9 < result.params[0] <= 2.0
    assert abs(result.params[1]) < 0.5


def test_the_loss_is_compiled_once_for_all_fits():
    traces = []

    def counted(params, key):
        traces.append(1)
        return (params["x"] - jax.random.normal(key)) ** 2

    for start in (1.0, 5.0):
        run(counted, {"x": start}, bijectors=None, steps=3)
    assert len(traces) <= 4  # values, gradients, and the looks that JAX takes at either


def two(params, key):
    return params["shares"][:2] + jax.random.normal(key, (2,))


@pytest.mark.parametrize(
    ("change", "message"),
    [
        *(({name: 0}, f"{name}: got 0, want an int ≥ 1")
          for name in ("steps", "batch", "holdout", "every", "patience", "micro_batch")),
        ({"key": 0}, r"key: got int, want a key from jax\.random\.key"),
        ({"clip": -1.0}, r"clip: got -1\.0, want a positive number"),
        ({"clip": "a"}, "clip: got str, want an array of numbers"),
        ({"loss": 3}, "loss: got int, want a hashable function"),
        ({"loss": two}, r"loss: got shape \[2\], want \[\]"),
        ({"loss": lambda params, key: {"a": params["scale"]}}, "loss: got dict, want an array"),
        ({"loss": lambda params, key: params["scale"] > 0}, "loss: got dtype bool, want floating"),
        ({"optimizer": "adam"}, "optimizer: got str, want one of optax, as optax.adam"),
        ({"optimizer": optax.adam}, "optimizer: got function, want one of optax"),
        ({"params": START | {"scale": "a"}}, r"params\['scale'\]: got str, want an array"),
        ({"bijectors": 2.0}, "bijectors: got float, want a pytree of Bijector"),
        ({"bijectors": {"scale": positive()}}, r"bijectors: got .*'scale'.*, want .*'shares'"),
        ({"bijectors": simplex()}, r"bijectors: got .*, want .*: y: got shape \[\], want \[n\]"),
    ],
)  # fmt: skip
def test_arguments_that_cannot_be_are_named(change, message):
    with pytest.raises((TypeError, ValueError), match=message):
        run(**change)


@pytest.mark.parametrize("left", [0, 1, 100, 0.5, 0.9, 1.0])
def test_a_broken_checkpoint_is_named(tmp_path, left):
    run(checkpoint=tmp_path, steps=1)
    file = tmp_path / FILE
    content = file.read_bytes()
    broken = (
        b"junk" * 100 if left == 1.0 else content[: int(left * (len(content) if left < 1 else 1))]
    )
    file.write_bytes(broken)
    with pytest.raises(
        ValueError, match=f"checkpoint: got .*{FILE}, which is broken .* want that of"
    ):
        run(checkpoint=tmp_path, steps=1)


def test_other_files_in_a_checkpoint_s_place_are_named(tmp_path):
    np.save(tmp_path / "plain.npy", np.zeros(3))
    (tmp_path / "plain.npy").rename(tmp_path / FILE)
    with pytest.raises(ValueError, match=f"checkpoint: got .*{FILE}, which is broken"):
        run(checkpoint=tmp_path, steps=1)
    np.savez(tmp_path / FILE, other=np.zeros(3))
    with pytest.raises(ValueError, match=f"checkpoint: got .*{FILE} of another fit"):
        run(checkpoint=tmp_path, steps=1)
    with pytest.raises(ValueError, match=f"checkpoint: got .*{FILE}, which is a file, want a fold"):
        run(checkpoint=tmp_path / FILE, steps=1)


def test_a_missing_checkpoint_is_none(tmp_path):
    assert checkpoint.read(tmp_path, "me", {"step": 0}) is None


@pytest.mark.parametrize("start", [{"scale": -1.0}, {"shares": jnp.array([0.5, 0.5, 0.2])}])
def test_a_start_outside_its_bijectors_range_is_refused(start):
    (name,) = start
    with pytest.raises(
        ValueError, match=rf"params\['{name}'\]: got .* inside its bijector's range"
    ):
        run(params=START | start)


def test_an_optimizer_that_reads_the_loss_gets_it():
    result = run(optimizer=optax.polyak_sgd(max_learning_rate=0.5))
    assert result.held_out < run().history.held_out[0]


@functools.cache
def least():
    """The parameters of least mean loss over the realizations of a fit that are common."""
    keys = [jax.random.fold_in(jax.random.fold_in(jax.random.fold_in(KEY, 0), 0), trial)
            for trial in range(8)]  # fmt: skip
    noise = 0.1 * np.mean([jax.random.normal(key, (4,)) for key in keys], axis=0)
    middle = np.array([0.2, 0.3, 0.5]) + noise[1:]
    return {"scale": 5.0 * np.exp(noise[0]), "shares": middle - (middle.sum() - 1.0) / 3}


def test_lbfgs_arrives_at_the_least_of_common_realizations():
    result = run(optimizer=optax.lbfgs(), fresh=False)
    at = jax.tree.map(lambda x: x[-1], result.history.params)
    jax.tree.map(functools.partial(np.testing.assert_allclose, rtol=1e-8), at, least())
    far = run(optimizer=optax.adam(0.2), fresh=False)
    assert result.history.loss[10] < far.history.loss[-1]


@pytest.mark.parametrize(
    "search",
    [optax.scale_by_backtracking_linesearch(20), optax.scale_by_zoom_linesearch(20)],
)
def test_line_searches_never_climb(search):
    history = run(optimizer=optax.chain(optax.sgd(1.0), search), fresh=False).history
    assert (np.diff(history.loss) <= 1e-12).all()
    assert history.loss[-1] < history.loss[0] / 10


@pytest.mark.parametrize("cut", [10, 13])
def test_a_fit_by_line_search_goes_on_bit_for_bit(tmp_path, cut):
    goes_on_bit_for_bit(tmp_path, cut, functools.partial(run, optimizer=optax.lbfgs(), fresh=False))


@pytest.mark.parametrize("fresh", [True, False])
def test_what_a_line_search_evaluates_is_the_mean_loss_of_the_step(fresh):
    def update(gradient, state, params, *, value, value_fn, **_):
        again, slope = jax.value_and_grad(value_fn)(params)
        differ = jax.tree.map(lambda x, y: 1e6 * jnp.abs(x - y), slope, gradient)
        return jax.tree.map(lambda x: x + 1e6 * jnp.abs(again - value), differ), state

    still = optax.GradientTransformationExtraArgs(lambda params: optax.EmptyState(), update)
    history = run(optimizer=still, fresh=fresh, steps=4).history
    for rows in history.params.values():
        np.testing.assert_allclose(rows, np.broadcast_to(rows[0], rows.shape), rtol=1e-7)
    assert len(set(history.loss.round(9))) == (4 if fresh else 1)


def test_a_line_search_gets_the_slope_that_is_not_clipped():
    def update(gradient, state, params, *, grad, **_):
        ratio = optax.tree.norm(grad) / optax.tree.norm(gradient)
        return jax.tree.map(lambda x: ratio + 0.0 * x, gradient), state

    told = optax.GradientTransformationExtraArgs(lambda params: optax.EmptyState(), update)
    history = run(optimizer=told, clip=1e-1, steps=1).history
    moved = np.log(history.params["scale"][1] / history.params["scale"][0])
    np.testing.assert_allclose(moved, history.grad_norm[0] / 1e-1, rtol=1e-9)
