import os
import stat

import numpy as np
import pytest
from PIL import Image as Pillow

from luxel.errors import InputError, MissingFileError
from luxel.picture.image import Image, check_output

PIXELS = np.random.default_rng(3).integers(0, 256, (4, 6, 3), dtype=np.uint8)


def test_size_is_width_and_height():
    image = Image(PIXELS)
    assert image.size == (6, 4)
    assert image.array is PIXELS


@pytest.mark.parametrize(
    "suffix, channels", [(".png", 3), (".png", 4), (".bmp", 3), (".tif", 4), (".tiff", 3), (".PNG", 3)]
)
def test_lossless_formats_give_the_pixels_back(tmp_path, suffix, channels):
    pixels = np.random.default_rng(3).integers(0, 256, (4, 6, channels), dtype=np.uint8)
    path = tmp_path / f"picture{suffix}"
    Image(pixels).save(path)
    np.testing.assert_array_equal(np.asarray(Pillow.open(path)), pixels)


@pytest.mark.parametrize("suffix", [".jpg", ".jpeg", ".webp"])
def test_lossy_formats_come_close(tmp_path, suffix):
    pixels = np.full((16, 16, 3), (200, 100, 50), np.uint8)
    path = tmp_path / f"picture{suffix}"
    Image(pixels).save(str(path))
    assert np.abs(np.asarray(Pillow.open(path)).astype(int) - pixels).max() <= 4


def test_transparency_becomes_white_where_a_format_has_none(tmp_path):
    Image(np.zeros((8, 8, 4), np.uint8)).save(tmp_path / "a.jpg")
    assert np.asarray(Pillow.open(tmp_path / "a.jpg")).min() >= 254


def test_repr_png():
    assert Image(PIXELS)._repr_png_().startswith(b"\x89PNG")


def test_save_replaces_and_leaves_nothing_else(tmp_path):
    path = tmp_path / "a.png"
    path.write_bytes(b"old")
    Image(PIXELS).save(path)
    assert Pillow.open(path).size == (6, 4)
    assert os.listdir(tmp_path) == ["a.png"]


@pytest.mark.skipif(os.name != "posix", reason="permissions are POSIX")
def test_saved_files_have_the_usual_permissions(tmp_path):
    (tmp_path / "plain").write_bytes(b"")
    Image(PIXELS).save(tmp_path / "a.png")
    assert stat.S_IMODE((tmp_path / "a.png").stat().st_mode) == stat.S_IMODE(
        (tmp_path / "plain").stat().st_mode
    )


def test_a_failed_write_keeps_the_old_file(tmp_path, monkeypatch):
    path = tmp_path / "a.png"
    path.write_bytes(b"old")

    def full(*_):
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(os, "replace", full)
    with pytest.raises(InputError, match="No space left"):
        Image(PIXELS).save(path)
    assert path.read_bytes() == b"old"
    assert os.listdir(tmp_path) == ["a.png"]


@pytest.mark.parametrize(
    "name, error, message",
    [
        ("a.xyz", InputError, r"\.xyz.*\.png"),
        ("a", InputError, "no suffix"),
        ("missing/a.png", MissingFileError, "missing"),
        ("folder.png", InputError, "directory"),
        ("file.txt/a.png", InputError, "directory"),
        ("x" * 300 + ".png", InputError, "name"),
    ],
)
def test_places_that_cannot_be_written(tmp_path, name, error, message):
    (tmp_path / "folder.png").mkdir()
    (tmp_path / "file.txt").write_text("")
    with pytest.raises(error, match=message):
        check_output(tmp_path / name) if len(name) < 250 else Image(PIXELS).save(tmp_path / name)
    assert sorted(os.listdir(tmp_path)) == ["file.txt", "folder.png"]


def test_folder_without_permission(tmp_path, monkeypatch):
    monkeypatch.setattr(os, "access", lambda *_: False)  # root, who may run the tests, may write anywhere
    with pytest.raises(InputError, match="permission"):
        check_output(tmp_path / "a.png")


@pytest.mark.parametrize(
    "pixels",
    [
        np.zeros((4, 6), np.uint8),
        np.zeros((4, 6, 2), np.uint8),
        np.zeros((4, 6, 3), np.float32),
        [[[0, 0, 0]]],
        None,
    ],
)
def test_bad_pixels_are_refused(pixels):
    with pytest.raises(InputError, match="uint8"):
        Image(pixels)


@pytest.mark.parametrize("name", ["ids", "depth"])
def test_planes_must_fit(name):
    with pytest.raises(InputError, match=name):
        Image(PIXELS, **{name: np.zeros((6, 4))})
