"""The store: a chunk counts once its record is there, and a broken one is never believed."""

import errno
import json
import os
import pathlib
import tempfile

import numpy as np
import pytest
import zarr

from jaxtrack.studies import chunk_store, chunks
from jaxtrack.studies.chunks import Variable
from jaxtrack.studies.study_file import StudyError
from tests.studies.own_study import as_nobody, bytes_in

ABOUT = {
    "mean.error_m": Variable(("sigma_m",), (2,), "float32"),
    "mean.found": Variable((), (), "bool"),
    "mean.count": Variable(("sigma_m", "mean.gate"), (2, 3), "int32"),
}
LABELS = {"labels": {"sigma_m": [1.0, 2.0], "mean.gate": ["a", "b", "c"]}}


def values(number, trials=4):
    draw = np.random.default_rng(number)
    return {
        "mean.error_m": draw.normal(size=(2, trials)).astype(np.float32),
        "mean.found": draw.random(trials) < 0.5,
        "mean.count": draw.integers(9, size=(2, 3, trials)).astype(np.int32),
    }


@pytest.fixture
def store(tmp_path):
    return chunk_store.create(tmp_path / "study", ABOUT, trials=10, chunk=4, attributes=LABELS)


def assert_is(found, number, trials=4):
    wanted = values(number, trials)
    assert found is not None
    assert found.keys() == wanted.keys()
    for name, array in wanted.items():
        np.testing.assert_array_equal(found[name], array)
        assert found[name].dtype == array.dtype


def test_chunks_come_back_labelled_and_the_last_may_be_short(store):
    for number, trials in ((0, 4), (2, 2), (1, 4)):
        chunks.write(store, number, values(number, trials))
    again = chunk_store.open_chunks(store.folder)
    assert (again.count, again.trials, again.chunk) == (3, 10, 4)
    assert chunks.committed(again) == {0, 1, 2}
    for number, trials in ((0, 4), (1, 4), (2, 2)):
        assert_is(chunks.read(again, number), number, trials)
    with chunks.dataset(again, 8) as data:
        assert data["mean.count"].dims == ("sigma_m", "mean.gate", "trial")
        assert data["mean.count"].sel({"sigma_m": 2.0, "mean.gate": "b"}).shape == (8,)
        whole = np.concatenate([values(0)["mean.found"], values(1)["mean.found"]])
        np.testing.assert_array_equal(data["mean.found"], whole)


def test_arrays_are_zarr_3_with_crc32c_one_file_a_chunk(store):
    chunks.write(store, 0, {name: np.zeros_like(x) for name, x in values(0).items()})
    for name in ABOUT:  # zeros are the fill value of two of them, and written all the same
        folder = store.folder / chunks.RESULTS / name
        meta = json.loads((folder / "zarr.json").read_text())
        assert meta["zarr_format"] == 3
        assert [codec["name"] for codec in meta["codecs"]] == ["bytes", "zstd", "crc32c"]
        assert len([file for file in (folder / "c").rglob("*") if file.is_file()]) == 1


def test_the_same_values_are_the_same_bytes(store, tmp_path):
    other = chunk_store.create(tmp_path / "other", ABOUT, trials=10, chunk=4, attributes=LABELS)
    for number in (0, 1):
        chunks.write(store, number, values(number))
    for number in (1, 0):
        chunks.write(other, number, values(7))
        chunks.write(other, number, values(number))
    assert bytes_in(store.folder) == bytes_in(other.folder)


def damage_truncated(file):
    file.write_bytes(file.read_bytes()[:-3])


def damage_empty(file):
    file.write_bytes(b"")


def damage_flipped(file):
    data = bytearray(file.read_bytes())
    data[len(data) // 2] ^= 1
    file.write_bytes(bytes(data))


def damage_gone(file):
    file.unlink()


@pytest.mark.parametrize("name", list(ABOUT))
@pytest.mark.parametrize("harm", [damage_truncated, damage_empty, damage_flipped, damage_gone])
def test_a_damaged_chunk_is_found_and_can_be_written_again(store, name, harm):
    for number in (0, 1):
        chunks.write(store, number, values(number))
    before = bytes_in(store.folder)
    folder = store.folder / chunks.RESULTS / name / "c"
    harm(next(file for file in sorted(folder.rglob("*")) if file.is_file()))
    assert chunks.read(store, 0) is None
    assert_is(chunks.read(store, 1), 1)
    chunks.write(store, 0, values(0))
    assert bytes_in(store.folder) == before


def test_another_chunks_values_are_not_believed(store):
    for number in (0, 1):
        chunks.write(store, number, values(number))
    folder = store.folder / chunks.RESULTS / "mean.found" / "c"
    (folder / "0").write_bytes((folder / "1").read_bytes())  # sound in itself
    assert chunks.read(store, 0) is None


@pytest.mark.parametrize("text", ["", "{", "[]", "{}", '{"checksums": {}}'])
def test_a_broken_record_is_no_record(store, text):
    chunks.write(store, 0, values(0))
    (store.folder / chunks.COMMITS / "00000000.json").write_text(text)
    assert chunks.read(store, 0) is None


class Killed(BaseException):
    """What no handler of errors sees."""


def test_a_write_that_ends_at_any_step_leaves_nothing_that_counts(store, monkeypatch):
    chunks.write(store, 0, values(0))
    before, whole, steps = bytes_in(store.folder), chunks.sync, 0
    while True:
        left = steps

        def sync(paths):
            nonlocal left
            if left == 0:
                raise Killed
            left -= 1
            whole(paths)

        with monkeypatch.context() as within:
            within.setattr(chunks, "sync", sync)
            try:
                chunks.write(store, 1, values(1))
                break
            except Killed:
                pass
        again = chunk_store.open_chunks(store.folder)
        assert_is(chunks.read(again, 0), 0)
        if chunks.read(again, 1) is None:
            chunks.clean(again)
            assert bytes_in(store.folder) == before
        else:  # the record was there, its folder's entry only not synced
            assert_is(chunks.read(again, 1), 1)
            (store.folder / chunks.COMMITS / "00000001.json").unlink()
        steps += 1
    assert steps == 3 + len(ABOUT)
    assert_is(chunks.read(store, 1), 1)


def test_a_making_that_ends_early_leaves_no_study(tmp_path, monkeypatch):
    def killed(paths):
        raise Killed

    with monkeypatch.context() as within:
        within.setattr(chunk_store, "sync", killed)
        with pytest.raises(Killed):
            chunk_store.create(tmp_path, ABOUT, trials=10, chunk=4, attributes={})
    with pytest.raises(StudyError, match="there is no study here"):
        chunk_store.open_chunks(tmp_path)
    store = chunk_store.create(tmp_path, ABOUT, trials=10, chunk=4, attributes={})
    chunks.clean(store)
    assert sorted(path.name for path in store.folder.iterdir()) == ["commits", "results.zarr"]


@pytest.mark.parametrize("at", range(7))
def test_a_full_disk_is_said_and_loses_nothing(store, monkeypatch, at):
    chunks.write(store, 0, values(0))
    before, sync, calls = bytes_in(store.folder), os.fsync, 0

    def full(handle):
        nonlocal calls
        calls += 1
        if calls == at + 1:
            raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))
        sync(handle)

    with monkeypatch.context() as within:
        within.setattr(os, "fsync", full)
        with pytest.raises(StudyError, match=r"trials 4 to 7 could not be written: No space left"):
            chunks.write(store, 1, values(1))
    assert bytes_in(store.folder) == before
    chunks.write(store, 1, values(1))
    assert_is(chunks.read(store, 1), 1)


def test_a_disk_that_is_full_under_zarr_is_said_and_loses_nothing(store, monkeypatch):
    chunks.write(store, 0, values(0))
    before = bytes_in(store.folder)

    async def full(self, key, value):
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))

    with monkeypatch.context() as within:
        within.setattr(zarr.storage.LocalStore, "set", full)
        with pytest.raises(StudyError, match=r"trials 4 to 7 could not be written: No space left"):
            chunks.write(store, 1, values(1))
    assert bytes_in(store.folder) == before


def test_a_folder_that_must_not_be_written_is_said_and_can_be_read():
    with tempfile.TemporaryDirectory() as name:
        folder = pathlib.Path(name) / "study"
        store = chunk_store.create(folder, ABOUT, trials=10, chunk=4, attributes=LABELS)
        chunks.write(store, 0, values(0))
        before = bytes_in(folder)
        paths = [folder.parent, folder, *folder.rglob("*")]
        for path in paths:
            path.chmod(0o555 if path.is_dir() else 0o444)
        try:
            with as_nobody():
                again = chunk_store.open_chunks(folder)
                assert_is(chunks.read(again, 0), 0)
                with pytest.raises(StudyError, match=r"cannot be written: Permission denied; what"):
                    chunks.check_writable(again)
                with pytest.raises(StudyError, match="trials 4 to 7 could not be written"):
                    chunks.write(again, 1, values(1))
                other = folder.parent / "other"
                with pytest.raises(StudyError, match="cannot be made: Permission denied"):
                    chunk_store.create(other, ABOUT, trials=10, chunk=4, attributes={})
        finally:
            for path in paths:
                path.chmod(0o755)
        assert bytes_in(folder) == before


def test_stores_of_another_kind_are_refused(store, tmp_path):
    meta = store.folder / chunks.RESULTS / "zarr.json"
    whole = meta.read_text()
    meta.write_text(whole.replace('"format": 2', '"format": 9'))
    with pytest.raises(StudyError, match="has format 9, this version of jaxtrack reads 2"):
        chunk_store.open_chunks(store.folder)
    meta.write_text(whole[:-20])
    with pytest.raises(StudyError, match="cannot be read"):
        chunk_store.open_chunks(store.folder)
    zarr.create_group(tmp_path / "paper" / chunks.RESULTS, zarr_format=3)
    with pytest.raises(StudyError, match="not those of a study's file"):
        chunk_store.open_chunks(tmp_path / "paper")


def test_a_chunk_is_removed_with_what_a_broken_write_left_of_it(store):
    for number in (0, 2):
        chunks.write(store, number, values(number, 4 - number))
    before = bytes_in(store.folder)
    for number in (0, 2):
        chunks.write(store, number, values(number, 4 - number))
    chunks.write(store, 1, values(1))
    commits, found = store.folder / chunks.COMMITS, store.folder / chunks.RESULTS / "mean.found"
    (commits / "half_00000001.json").write_text("{")
    (found / "c" / "1.0123.partial").write_bytes(b"x")
    chunks.remove(store, 1)
    assert bytes_in(store.folder) == before


def test_of_two_runs_that_begin_at_once_one_is_told(store):
    before = bytes_in(store.folder)
    about = {"mean.found": chunks.Variable((), (), "float32")}
    with pytest.raises(StudyError, match="another run began there at the same time"):
        chunk_store.create(store.folder, about, trials=4, chunk=2, attributes={})
    assert bytes_in(store.folder) == before


def test_what_a_broken_write_left_is_removed(store):
    chunks.write(store, 0, values(0))
    before = bytes_in(store.folder)
    chunks.write(store, 1, values(1))
    commits, found = store.folder / chunks.COMMITS, store.folder / chunks.RESULTS / "mean.found"
    (commits / "00000001.json").unlink()
    (commits / "half_00000002.json").write_text("{")
    (found / "c" / "2.0123.partial").write_bytes(b"x")
    (store.folder / "half_results.zarr.0123abcd").mkdir()
    chunks.clean(store)
    assert bytes_in(store.folder) == before
    assert sorted(path.name for path in store.folder.iterdir()) == ["commits", "results.zarr"]
