"""Every associator with its update: against loops, and what all of them promise."""

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
    cloud,
    gate,
    likelihood_ratios,
    nearest,
    predict_measurement,
    update_centroid,
    update_mixture,
)
from tests.association.cases import (
    KINDS,
    SIZES,
    as_lists,
    as_table,
    case,
    cases,
    predicted_of,
)
from tests.metrics.differences import assert_gradients_agree
from tests.oracles import association, pmht
from tests.oracles import cloud as clouds
from tests.oracles import jpda as enumeration

several = settings(max_examples=100, deadline=None, derandomize=True, database=None)
KEY = jax.random.key(3)
SEVERAL_ECHOES = ("cloud", "cloud_nearest", "cloud_averaged", "cloud_soft", "pmht")
EXCLUSIVE = ("greedy", "optimal", "jpda")


def run(mean, covariance, noise, mask, scan, params):
    """Return gates, ratios, and each associator's association and update."""
    predicted = predict_measurement(mean, covariance, noise, mask)
    found = {}
    for name, (associate, update) in ASSOCIATORS.items():
        taken = associate(predicted, scan, params, KEY)
        found[name] = taken, update(mean, covariance, predicted, scan, taken)
    gates = gate(predicted, scan, params.gate)
    return gates, likelihood_ratios(predicted, scan, params), found


everything = jax.jit(run)


@several
@given(cases())
def test_gates_and_associations_equal_the_loops(drawn):
    one, kind = drawn
    gates, (ratio, miss), found = everything(*one)
    tracks, detections = as_lists(one)
    p_detect, clutter, gamma, echoes = (float(x) for x in one.params)
    pairs = association.gated(tracks, detections, gamma)
    assert {(int(j), int(i)) for j, i in np.argwhere(gates.inside)} == set(pairs)
    for pair, squared in pairs.items():
        np.testing.assert_allclose(gates.squared_distance[pair], squared, rtol=1e-9)
    w, missed = association.ratios(tracks, detections, p_detect, clutter, gamma)
    np.testing.assert_allclose(ratio, w, rtol=1e-9, atol=1e-300)
    np.testing.assert_allclose(miss, missed, rtol=1e-12)

    size = len(detections)
    exact = enumeration.marginals(w, missed)
    agree = lambda name, table: np.testing.assert_allclose(
        found[name][0].weight, table, rtol=1e-8, atol=1e-11, err_msg=name
    )
    agree("jpda", exact[:, :-1])
    agree("pda", association.pda(w, missed)[:, :-1])
    agree("pmht", pmht.weights(tracks, detections, p_detect, clutter, gamma, echoes))
    if kind == "coincident":  # rounding decides between equals
        return
    for name in ("independent", "greedy", "optimal"):
        taken = getattr(association, name)(tracks, detections, gamma)
        agree("nearest" if name == "independent" else name, as_table(taken, size))
    slots = range(len(tracks))
    xi = [np.array(jax.random.normal(jax.random.fold_in(KEY, j), (2,), float)) for j in slots]
    kinds = (
        ("cloud", xi, "class"),
        ("cloud_nearest", xi, "nearest"),
        ("cloud_averaged", None, "class"),
    )
    for name, draws, pairing in kinds:
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
            own = taken.weight[j]
            weights = {int(i): float(own[i]) for i in np.flatnonzero(own > 0)}
            state = one.mean[j], one.covariance[j]
            if name in SEVERAL_ECHOES:
                noise = "shared" if name == "pmht" else "single"
                x, p = association.centroid(
                    *state, detections, weights, float(taken.miss[j]), noise
                )
            else:
                x, p = association.mixture(*state, detections, weights, float(taken.miss[j]))
            np.testing.assert_allclose(mean[j], x, rtol=1e-8, atol=1e-9, err_msg=name)
            np.testing.assert_allclose(covariance[j], p, rtol=1e-8, atol=1e-9, err_msg=name)
            assert (np.linalg.eigvalsh(covariance[j]) > 0).all()


@several
@given(cases())
def test_associations_are_ones(drawn):
    one, kind = drawn
    gates, _, found = everything(*one)
    for name, (taken, _) in found.items():
        assert taken.converged, name
        weight, miss = np.asarray(taken.weight), np.asarray(taken.miss)
        assert np.isfinite(weight).all(), name
        assert not weight[~np.asarray(gates.inside)].any(), name
        assert ((weight >= 0) & (weight <= 1 + 1e-12)).all(), name
        assert ((miss > -1e-12) & (miss <= 1 + 1e-12)).all(), name
        assert (miss[~one.mask] == 1).all() or name == "belief_propagation", name
        np.testing.assert_allclose(miss[~one.mask], 1.0, rtol=1e-12, err_msg=name)
        if name not in SEVERAL_ECHOES:
            np.testing.assert_allclose(weight.sum(1) + miss, 1.0, rtol=1e-9, err_msg=name)
        if name in EXCLUSIVE:
            assert (weight.sum(0) <= 1 + 1e-9).all(), name
        if kind in ("far", "no detections", "no tracks"):
            assert not weight.any(), name


@several
@given(cases(), st.randoms(use_true_random=False))
def test_order_of_detections_and_empty_places_change_nothing(drawn, random):
    one, kind = drawn
    if kind == "coincident":
        return
    tracks, detections = len(one.mask), len(one.scan.mask)
    order = random.sample(range(detections), detections)
    taken = [None if x is None else x[order] for x in one.scan[2:]]
    *_, found = everything(*one)
    *_, moved = everything(
        *one[:4],
        one.scan._replace(**dict(zip(one.scan._fields[2:], taken, strict=True))),
        one.params,
    )
    for name, (was, state) in found.items():
        now, after = moved[name]
        np.testing.assert_allclose(
            now.weight, was.weight[:, order], rtol=1e-8, atol=1e-10, err_msg=name
        )
        for a, b in zip(after, state, strict=True):
            np.testing.assert_allclose(a, b, rtol=1e-8, atol=1e-9, err_msg=name)
    assert tracks == len(one.mean)


@pytest.mark.parametrize("size", SIZES)
def test_padding_changes_nothing(size):
    for seed in range(10):
        one = case(seed, size, whole=True)
        pad = lambda x, n: (
            None if x is None else np.concatenate([x, np.full((n, *x.shape[1:]), np.nan)])
        )
        scan = one.scan._replace(
            position_m=pad(one.scan.position_m, 2),
            mask=np.append(one.scan.mask, [False, False]),
            covariance_m2=pad(one.scan.covariance_m2, 2),
            weight=pad(one.scan.weight, 2),
        )
        *_, found = everything(*one)
        *_, padded = everything(
            pad(one.mean, 1),
            pad(one.covariance, 1),
            one.noise_m2,
            np.append(one.mask, False),
            scan,
            one.params,
        )
        for name, (was, state) in found.items():
            now, after = padded[name]
            np.testing.assert_allclose(
                now.weight[:-1, :-2], was.weight, rtol=1e-8, atol=1e-11, err_msg=name
            )
            assert not now.weight[-1].any()
            assert not now.weight[:, -2:].any()
            for a, b in zip(after, state, strict=True):
                np.testing.assert_allclose(a[:-1], b, rtol=1e-8, atol=1e-10, err_msg=name)


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
        assert found[name][0].miss[0] == 1


batched = jax.jit(jax.vmap(run))


def stacked(count):
    return [case(seed) for seed in range(count)]


def test_vmap_is_a_loop():
    ones = stacked(4)
    got = batched(*jax.tree.map(lambda *x: np.stack(x), *ones))
    for n, one in enumerate(ones):
        for a, b in zip(jax.tree.leaves(got), jax.tree.leaves(everything(*one)), strict=True):
            np.testing.assert_allclose(a[n], b, rtol=1e-8, atol=1e-10)


def test_single_precision_stays_single_also_under_vmap():
    ones = stacked(8)
    whole = jax.tree.map(lambda *x: np.stack(x), *ones)
    small = jax.tree.map(lambda x: x.astype(np.float32) if x.dtype == np.float64 else x, whole)
    got = batched(*small)[2]
    expected = batched(*whole)[2]
    for name, (taken, state) in got.items():
        for leaf in jax.tree.leaves((taken.weight, taken.miss, state)):
            assert leaf.dtype == np.float32, name
        # The draws of the sampled clouds differ between precisions.
        if name not in ("cloud", "cloud_nearest"):
            np.testing.assert_allclose(
                taken.weight, expected[name][0].weight, rtol=2e-3, atol=2e-4, err_msg=name
            )
        finite = np.isfinite(whole.mean)
        assert np.isfinite(state[0])[finite].all()


@jax.jit
def gradients(mean, covariance, noise, mask, scan, params):
    """Return gradients of everything in everything, of all associators."""

    def loss(mean, covariance, noise, scan, params, name):
        predicted = predict_measurement(mean, covariance, noise, mask)
        associate, update = ASSOCIATORS[name]
        taken = associate(predicted, scan, params, KEY)
        x, p = update(mean, covariance, predicted, scan, taken)
        x, p = jnp.where(mask[:, None], x, 0.0), jnp.where(mask[:, None, None], p, 0.0)
        return (x**2).sum() + (p**2).sum() + (taken.miss**2).sum()

    return {
        name: jax.grad(loss, (0, 1, 2, 3, 4), allow_int=True)(
            mean, covariance, noise, scan, params, name
        )
        for name in ASSOCIATORS
    }


@pytest.mark.parametrize("kind", KINDS)
def test_gradients_are_finite_whatever_is_there(kind):
    for seed in range(5):
        one = case(seed, kind=kind)
        for name, found in gradients(*one).items():
            for leaf in jax.tree.leaves(found):
                if leaf.dtype != jax.dtypes.float0:
                    assert np.isfinite(leaf).all(), (name, kind)
            assert not found[3].position_m[~one.scan.mask].any()
            assert not found[0][~one.mask].any()


@pytest.mark.parametrize(
    "name", ["greedy", "pda", "jpda", "belief_propagation", "cloud_soft", "pmht"]
)
@pytest.mark.parametrize("size", SIZES)
def test_jitted_gradients_are_central_differences(name, size):
    one = case(11, (2, 3, size[2]), whole=True)
    associate, update = ASSOCIATORS[name]
    mask = jnp.ones(2, bool)
    scale = jnp.asarray(np.random.default_rng(1).normal(size=(2, 4)))

    def loss(mean, spread, noise, position, params):
        covariance = spread @ jnp.swapaxes(spread, 1, 2)
        predicted = predict_measurement(mean, covariance, (noise + noise.T) / 2, mask)
        scan = one.scan._replace(position_m=position)
        taken = associate(predicted, scan, AssociationParams(*params, 100.0, 2.5), KEY)
        x, p = update(mean, covariance, predicted, scan, taken)
        return (scale * x).sum() + (p * scale[:, :, None]).sum()

    spread = np.linalg.cholesky(one.covariance)
    arguments = one.mean, spread, one.noise_m2, one.scan.position_m, np.array([0.8, 0.02])
    assert_gradients_agree(loss, *arguments, atol=2e-8)


def test_with_all_weight_on_one_detection_both_updates_are_the_kalman_update():
    one = case(2, SIZES[1], whole=True)
    predicted = predicted_of(one)
    taken = Association(np.eye(4), np.zeros(4), np.array(True))
    for update in (update_mixture, update_centroid):
        mean, covariance = jax.jit(update)(one.mean, one.covariance, predicted, one.scan, taken)
        for j in range(4):
            x, p = association.kalman(
                one.mean[j], one.covariance[j], one.scan.position_m[j], one.noise_m2
            )
            np.testing.assert_allclose(mean[j], x, rtol=1e-10, atol=1e-12)
            np.testing.assert_allclose(covariance[j], p, rtol=1e-9, atol=1e-12)


def test_covariances_stay_definite_in_single_precision():
    mean, covariance = np.zeros((1, 4), np.float32), 1e8 * np.eye(4, dtype=np.float32)[None]
    covariance[:, 0, 2] = covariance[:, 2, 0] = 9e7
    one = case(0, (1, 2, False), whole=True)
    scan = one.scan._replace(position_m=np.zeros((2, 2), np.float32))
    noise = np.eye(2, dtype=np.float32) * np.float32(1e-2)
    predicted = predict_measurement(mean, covariance, noise)
    taken = Association(np.float32([[0.5, 0.5]]), np.float32([0.0]), np.array(True))
    for update in (update_mixture, update_centroid):
        _, p = jax.jit(update)(mean, covariance, predicted, scan, taken)
        assert p.dtype == np.float32
        np.testing.assert_allclose(p[0, 0, 0], 1e-2, rtol=0.6)
        assert (np.linalg.eigvalsh(np.asarray(p[0, :2, :2], float)) > 0).all()


def test_soft_classes_tend_to_the_crisp_ones():
    for seed in range(10):
        one = case(seed, SIZES[1], whole=True)
        predicted = predicted_of(one)
        crisp = cloud.averaged(predicted, one.scan, one.params).weight
        near = cloud.soft(predicted, one.scan, one.params, temperature=1e-6).weight
        np.testing.assert_allclose(near, crisp, atol=1e-6)


def test_other_keys_draw_other_widths_and_one_key_the_same():
    one = case(4, (3, 12, False), whole=True)
    predicted = predicted_of(one)
    draw = jax.jit(lambda key: cloud.sampled(predicted, one.scan, one.params, key).weight)
    first = draw(KEY)
    np.testing.assert_array_equal(first, draw(KEY))
    others = [draw(jax.random.key(seed)) for seed in range(30)]
    assert any((other != first).any() for other in others)


def test_clouds_pair_by_class_or_by_nearest_centre():
    # Track 0 has no echo of its own, but the class that started at track 1 is nearer to it.
    predicted = predict_measurement(
        jnp.array([[0.0, 0.0, 0.0, 0.0], [3.0, 0.0, 0.0, 0.0]]),
        jnp.stack([jnp.eye(4)] * 2),
        jnp.eye(2),
    )
    one = case(0, (1, 2, False), whole=True)
    scan = one.scan._replace(position_m=jnp.array([[1.6, 0.0], [1.7, 0.0]]))
    params = AssociationParams(0.9, 0.0)
    by_class = cloud.averaged(predicted, scan, params).weight
    np.testing.assert_array_equal(by_class, [[0, 0], [1, 1]])
    by_centre = cloud.averaged(predicted, scan, params, pairing="nearest").weight
    np.testing.assert_array_equal(by_centre, [[0, 0], [1, 1]])
    scan = scan._replace(position_m=jnp.array([[1.6, 0.0], [1.2, 0.0]]))
    crossed = cloud.averaged(predicted, scan, params, pairing="nearest").weight
    np.testing.assert_allclose(crossed.sum(0), 1.0)


def test_errors_name_the_argument():
    one = case(0, whole=True)
    predicted = predicted_of(one)
    with pytest.raises(ValueError, match="key: got None"):
        cloud.sampled(predicted, one.scan, one.params)
    with pytest.raises(ValueError, match="pairing: got 'closest'"):
        cloud.averaged(predicted, one.scan, one.params, pairing="closest")
    with pytest.raises(ValueError, match="noise: got 'own'"):
        update_centroid(
            one.mean,
            one.covariance,
            predicted,
            one.scan,
            nearest.greedy(predicted, one.scan, one.params),
            noise="own",
        )
    with pytest.raises(ValueError, match=r"covariance: got shape \[3, 2, 2\], want \[3, 4, 4\]"):
        predict_measurement(one.mean, one.covariance[:, :2, :2], one.noise_m2)
    with pytest.raises(ValueError, match=r"scan.weight: got shape \[1\], want \[5\]"):
        gate(predicted, one.scan._replace(weight=np.ones(1)))
