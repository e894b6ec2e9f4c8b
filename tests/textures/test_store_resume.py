"""Whatever ends a bake, nothing finished is lost, and taken up again it ends as if it had never been interrupted."""

import errno
import os

import pytest

import luxel
from luxel.errors import StorageError
from luxel.textures.store import arrays, files
from luxel.textures.store.layout import CodecChoice
from tests.textures.stores import bake, hashes, some

SERIES = [some(seed=k) for k in range(2)]
CODECS = {"raw": {}, "vq": {"codec": CodecChoice("vq", codewords=3)}}


def bake_both(path, codec, **more):
    return bake(path, SERIES, frames=[0, 1], **CODECS[codec], **more)


@pytest.fixture(scope="module", params=list(CODECS))
def codec(request):
    return request.param


@pytest.fixture(scope="module")
def uninterrupted(codec, tmp_path_factory):
    path = tmp_path_factory.mktemp("whole") / "a.zarr"
    bake_both(path, codec)
    return hashes(path)


class Killed(BaseException):
    """Stands for the end of the process: nothing in the library catches it."""


@pytest.fixture
def writes(monkeypatch):
    """Lets the n-th write from now on end badly."""

    class Writes:
        left = None

    real = files.write_file

    def write(path, content):
        if Writes.left is not None:
            Writes.left -= 1
            if Writes.left < 0:
                path.parent.mkdir(parents=True, exist_ok=True)
                path.with_name(path.name + files.DRAFT_SUFFIX).write_bytes(content[: len(content) // 2])
                raise Killed
        real(path, content)

    monkeypatch.setattr(arrays, "write_file", write)
    return Writes


def chunks(path):
    """Chunks that are finished; those of raw textures may go once they are compressed."""
    found = path.rglob("c/**/*")
    return {file for file in found if file.suffix != ".part" and file.is_file() and "raw" not in file.parts}


def test_killed_after_any_write(tmp_path, codec, uninterrupted, writes):
    """One bake that is killed over and over, each time one write farther on, until it gets through."""
    path, kills = tmp_path / "a.zarr", 0
    while True:
        writes.left = kills
        before = chunks(path)
        try:
            bake_both(path, codec)
        except Killed:
            kills += 1
            assert all(chunk.exists() for chunk in before)
        else:
            break
    assert kills > 10
    assert hashes(path) == uninterrupted


def test_killed_while_raw_textures_are_removed(tmp_path, monkeypatch):
    path = tmp_path / "a.zarr"
    real = files.remove_tree

    def remove(target):
        next(iter(target.rglob("c/*/*/*"))).unlink()
        raise Killed

    monkeypatch.setattr("luxel.textures.store.writer.remove_tree", remove)
    with pytest.raises(Killed):
        bake_both(path, "vq")
    monkeypatch.setattr("luxel.textures.store.writer.remove_tree", real)
    bake_both(path, "vq")
    bake_both(tmp_path / "b.zarr", "vq")
    assert hashes(path) == hashes(tmp_path / "b.zarr")


def test_killed_while_another_store_is_overwritten(tmp_path, codec, uninterrupted, writes):
    """What is left of the old store never ends up in the new one, even if that has the same settings at last."""
    for left in range(4):
        path = tmp_path / f"{left}.zarr"
        bake_both(path, codec, lights=(), chunk=3)
        writes.left = left
        with pytest.raises(Killed):
            bake_both(path, codec, overwrite=True)
        writes.left = None
        bake_both(path, codec, overwrite=left == 0)
        assert hashes(path) == uninterrupted


@pytest.mark.parametrize("code, words", [(errno.ENOSPC, "disk is full"), (errno.EACCES, "cannot write it")])
@pytest.mark.parametrize("step", [0, 9, 17, 30])
def test_full_disk(tmp_path, codec, uninterrupted, monkeypatch, step, code, words):
    path = tmp_path / "a.zarr"
    left, real = [step], os.fsync

    def fsync(descriptor):
        left[0] -= 1
        if left[0] < 0:
            raise OSError(code, os.strerror(code))
        real(descriptor)

    with monkeypatch.context() as patched:
        patched.setattr(os, "fsync", fsync)
        with pytest.raises(StorageError, match=words) as caught:
            bake_both(path, codec)
    message = str(caught.value)
    assert str(path) in message
    assert " — " in message
    assert isinstance(caught.value, OSError)
    assert not list(path.rglob("*.part"))
    bake_both(path, codec)
    assert hashes(path) == uninterrupted


def test_encoding_is_taken_up_again(tmp_path, codec, uninterrupted, writes):
    raw = bake(tmp_path / "raw.zarr", SERIES, frames=[0, 1])
    path, kills = tmp_path / "a.zarr", 0
    while True:
        writes.left = 1 + kills
        try:
            luxel.encode_to(path, raw, CODECS[codec].get("codec", "raw"))
        except Killed:
            kills += 1
        else:
            break
    assert kills > 3
    assert hashes(path) == uninterrupted
