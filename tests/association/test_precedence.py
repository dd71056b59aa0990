"""Association in two turns: who chooses first, and what is left."""

import functools

import jax
import numpy as np
import pytest

from jaxtrack.association import ASSOCIATORS, AssociationParams, gate, gated_once, in_turn
from tests.association.cases import SIZES, as_lists, as_table, case, predicted_of
from tests.oracles import association as oracle

NAMES = ("greedy", "optimal", "pda", "cloud")


@functools.cache
def compiled(name):
    associate = ASSOCIATORS[name].associate

    def run(mean, covariance, noise, mask, scan, params, first):
        one = predicted_of(case_of(mean, covariance, noise, mask, scan, params))
        key = jax.random.key(3)
        alone = associate(one, scan, params, jax.random.split(key)[0])
        return in_turn(associate, one, scan, params, key, first), alone

    return jax.jit(run)


def case_of(*fields):
    return type(case(0))(*fields)


@pytest.mark.parametrize("name", NAMES)
def test_those_who_choose_first_do_not_feel_the_others(name):
    for seed in range(8):
        one = case(seed)
        first = np.arange(len(one.mask)) != seed % 3
        (found, left), _ = compiled(name)(*one, first)
        without = one._replace(mask=one.mask & first)
        _, alone = compiled(name)(*without, first)
        here = first & one.mask
        np.testing.assert_allclose(found.weight[here], alone.weight[here], rtol=1e-12)
        np.testing.assert_allclose(found.miss[here], alone.miss[here], rtol=1e-12)
        np.testing.assert_allclose(left, np.maximum(1 - alone.weight.sum(0), 0.0), atol=1e-12)
        assert np.isfinite(found.weight).all()
        assert (np.asarray(found.weight)[~one.mask] == 0).all()


@pytest.mark.parametrize("name", NAMES)
def test_if_all_or_none_choose_first_it_is_the_associator(name):
    one = case(2, SIZES[1])
    everyone, nobody = np.ones(2, bool), np.zeros(2, bool)
    (found, _), alone = compiled(name)(*one, everyone)
    np.testing.assert_allclose(found.weight, alone.weight, rtol=1e-12)
    (found, left), _ = compiled(name)(*one, nobody)
    assert (np.asarray(left) == 1).all()
    if name != "cloud":  # the second turn draws other numbers
        np.testing.assert_allclose(found.weight, alone.weight, rtol=1e-12)
        np.testing.assert_allclose(found.miss, alone.miss, rtol=1e-12)


@pytest.mark.parametrize("name", ["greedy", "optimal"])
def test_the_others_choose_among_what_is_left_as_in_a_loop(name):
    taken_away = 0
    for seed in range(30):
        one = case(seed, whole=True)
        first = np.array([True, False, False])
        (found, left), together = compiled(name)(*one, first)
        tracks, detections = as_lists(one)
        choose = functools.partial(getattr(oracle, name), gate=float(one.params.gate))
        sure = choose([tracks[0], None, None], detections)
        rest = [None if i in sure[0] else d for i, d in enumerate(detections)]
        others = choose([None, *tracks[1:]], rest)
        expected = as_table([sure[0], *others[1:]], len(detections))
        np.testing.assert_array_equal(found.weight, expected)
        np.testing.assert_array_equal(left, 1 - expected[0])
        taken_away += (expected != np.asarray(together.weight)).any()
    assert taken_away  # it is not what they do at once


def test_a_new_track_does_not_take_a_sure_tracks_detection():
    mean = np.zeros((2, 4))
    mean[1, 0] = 1.0
    wide = np.stack([np.eye(4), 20.0 * np.eye(4)])  # the wide one is the nearer one by d²
    places = np.array([[1.5, 0.0], [90.0, 0.0], [50.0, 0.0]])
    scan = case(0, SIZES[1])[4]._replace(position_m=places, mask=np.ones(3, bool))
    fields = mean, wide, np.eye(2), np.ones(2, bool), scan, AssociationParams(0.9, 1e-3)
    (found, _), together = compiled("greedy")(*fields, np.array([True, False]))
    assert together.weight[:, 0].tolist() == [0.0, 1.0]
    assert found.weight[:, 0].tolist() == [1.0, 0.0]


def test_what_does_not_fit_is_named():
    one = case(0)
    with pytest.raises(ValueError, match=r"first: got shape \[2\], want \[3\]"):
        in_turn(ASSOCIATORS["greedy"].associate, predicted_of(one), one.scan, one.params, None,
                np.ones(2, bool))  # fmt: skip


def test_gates_that_are_known_are_narrowed_to_what_gates_would_be():
    once = jax.jit(lambda one, scan, limit: gated_once(one, scan, limit))
    plain = jax.jit(gate)
    for seed in range(6):
        one = case(seed, SIZES[seed % 2])
        predicted, limit = predicted_of(one), one.params.gate
        known = once(predicted, one.scan, limit)
        rng = np.random.default_rng(seed)
        tracks, detections = len(one.mask), len(one.scan.mask)
        fewer = rng.random(tracks) < 0.6
        weight = rng.uniform(0.0, 1.0, detections) * (rng.random(detections) < 0.8)
        scan = one.scan._replace(weight=np.where(one.scan.mask, weight, np.nan))
        narrow = gate(known._replace(mask=known.mask & fewer), scan, limit)
        anew = plain(predicted._replace(mask=predicted.mask & fewer), scan, limit)
        np.testing.assert_array_equal(narrow.inside, anew.inside)
        np.testing.assert_allclose(narrow.density_per_m2, anew.density_per_m2, rtol=1e-12)
        inside = np.asarray(anew.inside)
        near = np.asarray(narrow.squared_distance)[inside]
        np.testing.assert_allclose(near, np.asarray(anew.squared_distance)[inside], rtol=1e-12)
