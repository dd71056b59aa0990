"""Every associator with its update: against loops, and what all of them promise."""

import functools

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from jaxtrack.association import (
    ASSOCIATORS,
    Association,
    AssociationParams,
    Predicted,
    cloud,
    gate,
    likelihood_ratios,
    predict_measurement,
    update_centroid,
    update_mixture,
    update_single,
)
from jaxtrack.types import Scan
from tests.association.cases import KINDS, SIZES, as_lists, as_table, case, cases, predicted_of
from tests.oracles import association, pmht
from tests.oracles import cloud as clouds
from tests.oracles import jpda as enumeration

pytestmark = pytest.mark.slow  # compiles for a minute where nothing is cached

several = settings(max_examples=25, deadline=None, derandomize=True, database=None)
KEY = jax.random.key(3)
EXCLUSIVE = ("greedy", "optimal", "jpda")
SINGLE = ("cloud", "cloud_nearest", "cloud_averaged", "cloud_soft")
SHARED = ("pmht",)
CHOSEN = ("nearest", "greedy", "optimal")
ONE_ECHO = tuple(name for name in ASSOCIATORS if name not in SINGLE + SHARED)
UPDATES = {
    update_mixture: tuple(name for name in ONE_ECHO if name not in CHOSEN),
    update_single: CHOSEN,
    functools.partial(update_centroid, noise="single"): SINGLE,
    update_centroid: SHARED,
}


def run(mean, covariance, noise, mask, scan, params, names=tuple(ASSOCIATORS)):
    """Return gates, ratios, and each associator's association and update."""
    predicted = predict_measurement(mean, covariance, noise, mask)
    taken = {name: ASSOCIATORS[name].associate(predicted, scan, params, KEY) for name in names}
    found = {}
    for update, group in UPDATES.items():  # compiled once for all that use it
        held = [name for name in group if name in names]
        if not held:
            continue
        together = jax.tree.map(lambda *x: jnp.stack(x), *(taken[name] for name in held))
        states = jax.vmap(functools.partial(update, mean, covariance, predicted, scan))(together)
        for n, name in enumerate(held):
            found[name] = taken[name], tuple(x[n] for x in states)
    gates = gate(predicted, scan, params.gate)
    return gates, likelihood_ratios(predicted, scan, params), found


everything = jax.jit(run, static_argnames="names")


def test_each_associator_has_the_update_of_its_kind():
    for update, names in UPDATES.items():
        for name in names:
            own = ASSOCIATORS[name].update
            wanted = getattr(update, "func", update), getattr(update, "keywords", {})
            assert (getattr(own, "func", own), getattr(own, "keywords", {})) == wanted


@several
@given(cases())
def test_gates_and_associations_equal_the_loops(drawn):
    one, kind = drawn
    gates, (ratio, miss), found = everything(*one)
    tracks, detections = as_lists(one)
    p_detect = float(one.params.p_detect[0])
    clutter, gamma, echoes = (float(x) for x in one.params[1:])
    pairs = association.gated(tracks, detections, gamma)
    assert {(int(j), int(i)) for j, i in np.argwhere(gates.inside)} == set(pairs)
    for pair, squared in pairs.items():
        np.testing.assert_allclose(gates.squared_distance[pair], squared, rtol=1e-9)
    w, missed = association.ratios(tracks, detections, p_detect, clutter, gamma)
    np.testing.assert_allclose(ratio, w, rtol=1e-9, atol=1e-300)
    np.testing.assert_allclose(miss, missed, rtol=1e-12)

    size = len(detections)
    agree = lambda name, table: np.testing.assert_allclose(
        found[name][0].weight, table, rtol=1e-8, atol=1e-11, err_msg=name
    )
    agree("jpda", enumeration.marginals(w, missed)[:, :-1])
    agree("pda", association.pda(w, missed)[:, :-1])
    agree("pmht", pmht.weights(tracks, detections, p_detect, clutter, gamma, echoes))
    if kind == "coincident":  # rounding decides between equals
        return
    for name in ("independent", "greedy", "optimal"):
        taken = getattr(association, name)(tracks, detections, gamma)
        agree("nearest" if name == "independent" else name, as_table(taken, size))
    slots = range(len(tracks))
    xi = [np.array(jax.random.normal(jax.random.fold_in(KEY, j), (2,), float)) for j in slots]
    for name, draws, pairing in (
        ("cloud", xi, "class"),
        ("cloud_nearest", xi, "nearest"),
        ("cloud_averaged", None, "class"),
    ):
        taken = clouds.associate(tracks, detections, one.noise_m2, gamma, draws, pairing)
        agree(name, as_table(taken, size))


@several
@given(cases())
def test_updates_equal_the_moments_of_the_mixture_and_the_update_with_the_centroid(drawn):
    one, _ = drawn
    *_, found = everything(*one)
    _, detections = as_lists(one)
    for name, (taken, (mean, covariance)) in found.items():
        for j in np.flatnonzero(one.mask):
            own, miss = taken.weight[j], float(taken.miss[j])
            weights = {int(i): float(own[i]) for i in np.flatnonzero(own > 0)}
            state = one.mean[j], one.covariance[j]
            if name in ONE_ECHO:
                x, p = association.mixture(*state, detections, weights, miss)
            else:
                noise = "shared" if name in SHARED else "single"
                x, p = association.centroid(*state, detections, weights, miss, noise)
            np.testing.assert_allclose(mean[j], x, rtol=1e-8, atol=1e-9, err_msg=name)
            np.testing.assert_allclose(covariance[j], p, rtol=1e-8, atol=1e-9, err_msg=name)
            assert (np.linalg.eigvalsh(covariance[j]) > 0).all()


@several
@given(cases())
def test_associations_are_ones(drawn):
    one, kind = drawn
    gates, _, found = everything(*one)
    for name, (taken, _) in found.items():
        assert taken.converged or name == "cloud_soft", name
        weight, miss = np.asarray(taken.weight), np.asarray(taken.miss)
        assert not weight[~np.asarray(gates.inside)].any(), name
        assert ((weight >= 0) & (weight <= 1 + 1e-12)).all(), name
        assert ((miss > -1e-12) & (miss <= 1 + 1e-12)).all(), name
        np.testing.assert_allclose(miss[~one.mask], 1.0, rtol=1e-12, err_msg=name)
        if name in ONE_ECHO:
            np.testing.assert_allclose(weight.sum(1) + miss, 1.0, rtol=1e-9, err_msg=name)
        if name in EXCLUSIVE:
            assert (weight.sum(0) <= 1 + 1e-9).all(), name
        if kind in ("far", "no detections", "no tracks"):
            assert not weight.any(), name


def assert_same(found, expected, weights, states):
    """Compare associations and updates, the found ones through a view."""
    for name, (was, state) in expected.items():
        now, after = found[name]
        close = functools.partial(np.testing.assert_allclose, rtol=1e-8, atol=1e-9, err_msg=name)
        close(weights(now.weight), was.weight)
        for a, b in zip(after, state, strict=True):
            close(states(a), b)


@several
@given(cases(), st.randoms(use_true_random=False))
def test_the_order_of_detections_does_not_matter(drawn, random):
    one, kind = drawn
    if kind == "coincident":  # rounding decides between equals
        return
    order = np.array(random.sample(range(len(one.scan.mask)), len(one.scan.mask)))
    shuffled = jax.tree.map(lambda x: x[order] if x.ndim else x, one.scan)
    *_, found = everything(*one)
    *_, moved = everything(*one[:4], shuffled, one.params)
    assert_same(moved, found, lambda weight: weight[:, np.argsort(order)], lambda state: state)


def padded(x, count):
    """Return x with so many rows of NaN, or of False, behind."""
    empty = np.zeros((count, *x.shape[1:]), x.dtype)
    return np.concatenate([x, empty if x.dtype == bool else np.full_like(empty, np.nan)])


def test_padding_changes_nothing_nor_do_covariances_that_are_the_noise_and_weights_of_one():
    for seed in range(20):
        one = case(seed, SIZES[1], whole=True)
        own = np.broadcast_to(one.noise_m2, (3, 2, 2))
        scan = one.scan._replace(covariance_m2=own, weight=np.ones(3))
        wide = jax.tree.map(lambda x: padded(x, 2) if x.ndim else x, scan)
        detect = one.params._replace(p_detect=padded(one.params.p_detect, 1))
        tracks = padded(one.mean, 1), padded(one.covariance, 1), one.noise_m2, padded(one.mask, 1)
        *_, found = everything(*one)
        *_, more = everything(*tracks, wide, detect)
        assert_same(more, found, lambda weight: weight[:-1, :-2], lambda state: state[:-1])
        for taken, _ in more.values():
            assert not taken.weight[-1].any()
            assert not taken.weight[:, -2:].any()


def test_an_invalid_look_changes_no_state():
    one = case(0, whole=True)
    *_, found = everything(*one[:4], one.scan._replace(valid=np.array(False)), one.params)
    for name, (taken, (mean, covariance)) in found.items():
        np.testing.assert_array_equal(taken.weight, 0.0, err_msg=name)
        np.testing.assert_allclose(mean, one.mean, rtol=1e-12, err_msg=name)
        np.testing.assert_allclose(covariance, one.covariance, rtol=1e-9, atol=1e-12, err_msg=name)


def test_a_target_that_cannot_be_seen_takes_nothing():
    one = case(1, whole=True)
    unseen = one.params._replace(p_detect=np.array([0.0, 0.9, 0.9]))
    *_, found = everything(*one[:5], unseen)
    for name in ("pda", "jpda", "belief_propagation", "pmht"):
        assert not found[name][0].weight[0].any()
        assert found[name][0].weight[1:].any()
        assert found[name][0].miss[0] == 1


def test_a_batch_in_single_precision_is_the_loop_in_double():
    ones = [case(seed) for seed in range(8)]
    single = lambda *x: np.stack(x).astype(np.float32 if x[0].dtype == np.float64 else x[0].dtype)
    *_, got = jax.jit(jax.vmap(run))(*jax.tree.map(single, *ones))
    for name, (taken, state) in got.items():
        for leaf in (taken.weight, taken.miss, *state):
            assert leaf.dtype == np.float32, name
        for n, one in enumerate(ones):
            expected = everything(*one)[2][name]
            assert np.isfinite(state[0][n][one.mask]).all()
            if name in ("cloud", "cloud_nearest"):  # draws differ between precisions
                continue
            close = functools.partial(np.testing.assert_allclose, rtol=5e-3, atol=5e-4)
            close(taken.weight[n], expected[0].weight, err_msg=name)
            close(state[0][n], expected[1][0], err_msg=name)
            close(state[1][n], expected[1][1], err_msg=name)


SMOOTH = ("jpda", "cloud_soft", "pmht")
SCALES = np.random.default_rng(1).normal(size=(2, len(ASSOCIATORS), 3, 4))


def loss(mean, root, noise, position, weight, numbers, scan, mask, names):
    """Return a number of all updated states, given square roots of the covariances."""
    there = mask[:, None, None]
    known = jnp.where(there, root, 0.0)
    covariance = jnp.where(there, known @ jnp.swapaxes(known, 1, 2), jnp.nan)
    scan = scan._replace(position_m=position, weight=weight)
    params = AssociationParams(numbers[0], numbers[1], numbers[2], 2.5)
    *_, found = run(mean, covariance, (noise + noise.T) / 2, mask, scan, params, names)
    total = jnp.zeros(())
    for (taken, (x, p)), a, b in zip(found.values(), *SCALES, strict=False):
        a, b = (jnp.asarray(scale[: len(mask)]) for scale in (a, b))
        total = total + jnp.where(mask[:, None], a * x, 0.0).sum() + taken.miss.sum()
        total = total + jnp.where(mask[:, None, None], b[:, :, None] * p, 0.0).sum()
    return total


value = jax.jit(loss, static_argnames="names")
gradient = jax.jit(jax.grad(loss, (0, 1, 2, 3, 4, 5)), static_argnames="names")


def roots(one):
    """Return square roots of the covariances; NaN in empty slots."""
    known = np.where(one.mask[:, None, None], one.covariance, np.eye(4))
    return np.where(one.mask[:, None, None], np.linalg.cholesky(known), np.nan)


def parts(one, gate):
    """Return what the loss is differentiated by."""
    numbers = np.array([0.8, 0.02, gate])
    return [one.mean, roots(one), one.noise_m2, one.scan.position_m, one.scan.weight, numbers]


def test_jitted_gradients_are_central_differences():
    one = case(11, whole=True)
    arguments = parts(one, 100.0)  # a wide gate: nothing crosses it
    rest = one.scan, one.mask
    found = gradient(*arguments, *rest, names=SMOOTH)
    for place, argument in enumerate(arguments):
        for index in np.ndindex(argument.shape):
            ends = []
            for step in (1e-5, -1e-5):
                moved = argument.copy()
                moved[index] += step
                changed = [*arguments[:place], moved, *arguments[place + 1 :]]
                ends.append(float(value(*changed, *rest, names=SMOOTH)))
            expected = (ends[0] - ends[1]) / 2e-5
            np.testing.assert_allclose(found[place][index], expected, rtol=1e-6, atol=1e-7)


@pytest.mark.parametrize("kind", KINDS)
def test_gradients_are_finite_whatever_is_there(kind):
    for seed in range(10):
        one = case(seed, kind=kind)
        found = gradient(*parts(one, 9.21), one.scan, one.mask, names=SMOOTH)
        assert all(np.isfinite(leaf).all() for leaf in found)
        assert not found[0][~one.mask].any()
        assert not found[3][~one.scan.mask].any()
        assert not found[4][~one.scan.mask].any()


def test_with_all_weight_on_one_detection_both_updates_are_the_kalman_update():
    one = case(2, (3, 3, False), whole=True)
    predicted = predicted_of(one)
    taken = Association(np.eye(3), np.zeros(3), np.array(True))
    for update in (update_mixture, update_centroid):
        mean, covariance = jax.jit(update)(one.mean, one.covariance, predicted, one.scan, taken)
        for j in range(3):
            z = one.scan.position_m[j]
            x, p = association.kalman(one.mean[j], one.covariance[j], z, one.noise_m2)
            np.testing.assert_allclose(mean[j], x, rtol=1e-10, atol=1e-12)
            np.testing.assert_allclose(covariance[j], p, rtol=1e-9, atol=1e-12)


def test_covariances_stay_definite_in_single_precision():
    mean, covariance = np.zeros((1, 4), np.float32), 1e8 * np.eye(4, dtype=np.float32)[None]
    one = case(0, (1, 2, False), whole=True)
    scan = one.scan._replace(position_m=np.zeros((2, 2), np.float32))
    noise = np.eye(2, dtype=np.float32) * np.float32(1e-2)
    predicted = predict_measurement(mean, covariance, noise)
    taken = Association(np.float32([[0.5, 0.5]]), np.float32([0.0]), np.array(True))
    for update, variance in ((update_mixture, 1e-2), (update_centroid, 1e-2)):
        _, p = jax.jit(update)(mean, covariance, predicted, scan, taken)
        assert p.dtype == np.float32
        np.testing.assert_allclose(p[0], np.diag([variance, variance, 1e8, 1e8]), rtol=1e-3)


def test_soft_classes_tend_to_the_crisp_ones():
    cold = jax.jit(functools.partial(cloud.soft, temperature=1e-6))
    for seed in range(20):
        one = case(seed, SIZES[1], whole=True)
        crisp = everything(*one)[2]["cloud_averaged"][0].weight
        np.testing.assert_allclose(cold(predicted_of(one), one.scan, one.params).weight, crisp)


def test_keys_draw_widths():
    one = case(0, (2, 20, False), whole=True)
    one.mean[:, :2] = [[0.0, 0.0], [1.5, 0.0]]
    position = np.random.default_rng(0).normal([0.7, 0.0], size=(20, 2))
    scan = one.scan._replace(position_m=position)
    draw = jax.jit(lambda key: cloud.sampled(predicted_of(one), scan, one.params, key).weight)
    first = draw(KEY)
    np.testing.assert_array_equal(first, draw(KEY))
    assert any((draw(jax.random.key(seed)) != first).any() for seed in range(20))


def test_errors_name_the_argument():
    one = case(0, whole=True)
    predicted = predicted_of(one)
    with pytest.raises(ValueError, match="key: got None"):
        cloud.sampled(predicted, one.scan, one.params)
    with pytest.raises(ValueError, match="pairing: got 'closest'"):
        cloud.averaged(predicted, one.scan, one.params, pairing="closest")
    taken = Association(np.zeros((3, 5)), np.ones(3), np.array(True))
    with pytest.raises(ValueError, match="noise: got 'own'"):
        update_centroid(one.mean, one.covariance, predicted, one.scan, taken, noise="own")
    with pytest.raises(ValueError, match=r"covariance: got shape \[3, 2, 2\], want \[3, 4, 4\]"):
        predict_measurement(one.mean, one.covariance[:, :2, :2], one.noise_m2)
    with pytest.raises(ValueError, match=r"scan.weight: got shape \[1\], want \[5\]"):
        gate(predicted, one.scan._replace(weight=np.ones(1)))


@pytest.mark.parametrize("associate", [cloud.averaged, cloud.soft])
def test_clouds_take_a_covariance_of_each_track(associate):
    places = jnp.array([[0.0, 0.0], [4.0, 0.0], [np.nan, np.nan]])
    spread, noise = jnp.stack([jnp.eye(2)] * 3), jnp.diag(jnp.array([0.3, 0.5]))
    mask = jnp.array([True, True, False])
    shared = Predicted(places, spread, noise, mask)
    own = shared._replace(noise_m2=jnp.stack([noise, noise, jnp.full((2, 2), jnp.nan)]))
    at = jnp.array([[0.1, 0.2], [1.0, 0.0], [4.0, 1.0]])
    scan = Scan(jnp.array(0.0), jnp.array(True), at, jnp.ones(3, bool))
    params = AssociationParams(0.9, 1e-3)
    want = associate(shared, scan, params).weight
    np.testing.assert_allclose(associate(own, scan, params).weight, want, atol=1e-12)
    assert want[:2].sum() > 1.5
