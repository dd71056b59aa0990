import jax
import jax.numpy as jnp
import numpy as np
import pytest

from jaxtrack.tracking.lifecycle import Births, LifecycleParams, admit, empty_table, grade
from jaxtrack.types import Stage
from tests.oracles.lifecycle import Book

SLOTS, STATE, LAST, CANDIDATES = 4, 2, 5, 3
PARAMS = LifecycleParams(3, delete_misses=3, delete_tentative_misses=2, delete_unseen=5)


@jax.jit
def run(looks, params=PARAMS):
    def step(table, look):
        hit, counted, valid, births = look
        table = grade(table, hit, counted, valid, params)
        table, crowded, _ = admit(table, births, params)
        return table, (table, crowded)

    begin = empty_table(jnp.zeros(()), tracks=SLOTS, state=STATE, looks=LAST)
    return jax.lax.scan(step, begin, looks)[1]


def random_looks(seed, looks, p_hit=0.6, p_counted=0.8, p_birth=0.15):
    rng = np.random.default_rng(seed)
    mask = rng.random((looks, CANDIDATES)) < p_birth
    mean = np.where(mask[..., None], rng.normal(size=(looks, CANDIDATES, STATE)), np.nan)
    return (
        rng.random((looks, SLOTS)) < p_hit,
        rng.random((looks, SLOTS)) < p_counted,
        rng.random(looks) < 0.9,
        Births(
            mean,
            np.where(mask[..., None, None], np.eye(STATE), np.nan),
            mask,
            np.where(mask, rng.permuted(np.arange(looks * CANDIDATES)).reshape(mask.shape), np.nan),
        ),
    )


@pytest.mark.parametrize("hits", [1, 2])
def test_few_hits_confirm_only_what_has_the_score(hits):
    looks = random_looks(7, 40, p_hit=0.7, p_birth=0.3)
    score = float(np.nanmedian(looks[3].log_score))
    tables, _ = run(looks, PARAMS._replace(confirm_hits=hits, confirm_score=score))
    book = Book(SLOTS, LAST, hits, 3, 2, score, unseen=5)
    seen = set()
    for k in range(40):
        book.grade(*(x[k] for x in looks[:3]))
        there = np.flatnonzero(looks[3].mask[k])
        book.admit([(looks[3].mean[k, n], looks[3].log_score[k, n]) for n in there])
        stages = [0 if track is None else track.stage for track in book.slots]
        np.testing.assert_array_equal(tables.tracks.stage[k], stages)
        seen |= {(track.history.count(True) >= hits, track.stage) for track in book.slots if track}
    assert {(True, 1), (True, 2)} <= seen


@pytest.mark.parametrize("seed", range(10))
def test_it_does_what_a_book_of_objects_does(seed):
    looks = random_looks(seed, 40, p_hit=0.3 + 0.06 * seed)
    tables, crowded = run(looks)
    book = Book(SLOTS, LAST, 3, 3, 2, unseen=5)
    stages = set()
    for k in range(40):
        book.grade(*(x[k] for x in looks[:3]))
        births = looks[3]
        there = np.flatnonzero(births.mask[k])
        full = book.admit([(births.mean[k, n], births.log_score[k, n]) for n in there])
        assert bool(crowded[k]) == full
        tracks = jax.tree.map(lambda x, k=k: x[k] if x.ndim else x, tables.tracks)
        for slot, track in enumerate(book.slots):
            assert bool(tracks.mask[slot]) == (track is not None)
            if track is None:
                assert tracks.identity[slot] == -1
                assert tracks.stage[slot] == Stage.EMPTY
                assert not tracks.mean[slot].any()
            else:
                assert tracks.identity[slot] == track.identity
                assert tracks.stage[slot] == track.stage
                assert tables.misses[k, slot] == track.misses
                assert tables.unseen[k, slot] == track.unseen
                np.testing.assert_array_equal(tracks.mean[slot], track.mean)
                np.testing.assert_array_equal(tracks.covariance[slot], np.eye(STATE))
                stages.add(track.stage)
    assert stages == {Stage.TENTATIVE, Stage.CONFIRMED, Stage.COASTING}


def test_empty_looks_delete_all_and_lost_ones_none():
    looks = 60
    hit, counted, _, births = random_looks(1, looks, p_hit=1.0, p_counted=1.0, p_birth=0.3)
    valid = np.ones(looks, bool)
    births = births._replace(mask=births.mask & (np.arange(looks) < 10)[:, None])
    empty = hit & (np.arange(looks) < 20)[:, None]
    tables, _ = run((empty, counted, valid, births))
    assert tables.tracks.mask[19].all()
    assert not tables.tracks.mask[-1].any()
    assert tables.next_identity[-1] == tables.next_identity[19]
    tables, _ = run((empty, counted, valid & (np.arange(looks) < 20), births))
    for leaf in jax.tree.leaves(tables):
        np.testing.assert_array_equal(leaf[-1], leaf[19])


def test_out_of_sight_tentative_tracks_go_and_confirmed_ones_stay_for_long():
    looks = 12
    step = np.arange(looks)
    there = np.zeros((looks, CANDIDATES), bool)
    there[0, 0] = there[3, 0] = True  # the second has no time to be confirmed
    births = Births(
        np.zeros((looks, CANDIDATES, STATE)),
        np.broadcast_to(np.eye(STATE), (looks, CANDIDATES, STATE, STATE)),
        there,
        np.zeros((looks, CANDIDATES)),
    )
    seen = np.broadcast_to((step < 5)[:, None], (looks, SLOTS))
    tables, _ = run((seen, seen, np.ones(looks, bool), births))
    lives = [np.flatnonzero(np.asarray(tables.tracks.identity == who).any(1)) for who in (0, 1)]
    assert tables.tracks.stage[4].tolist() == [Stage.CONFIRMED, Stage.TENTATIVE, 0, 0]
    assert [life[-1] for life in lives] == [8, 5]


def test_identities_are_never_used_again():
    looks = random_looks(3, 400, p_hit=0.4, p_birth=0.4)
    tables, _ = run(looks)
    identity, mean = np.asarray(tables.tracks.identity), np.asarray(tables.tracks.mean)
    seen = {}
    for k, slot in np.argwhere(identity >= 0):
        own = mean[k, slot].tolist()
        assert seen.setdefault(int(identity[k, slot]), own) == own
    assert len(seen) == int(tables.next_identity[-1]) > 100


def test_wrong_shapes_are_named():
    table = empty_table(jnp.zeros(()), tracks=2, state=4, looks=3)
    with pytest.raises(ValueError, match=r"hit: got shape"):
        grade(table, jnp.ones(3, bool), jnp.ones(2, bool), jnp.array(True), PARAMS)
    with pytest.raises(ValueError, match=r"tracks: got 0"):
        empty_table(jnp.zeros(()), tracks=0, state=4, looks=3)
