"""The store: what goes in comes out; other programs can read it; damage is noticed; another bake is never mixed in."""

import json
import shutil
import subprocess
import sys

import numpy as np
import pytest
import zarr

import luxel
from luxel.errors import FormatError, FrameError, InputError, LuxelError, MissingFileError, StorageError
from luxel.scene.lights import QuadLight, Sky, SphereLight, Sun
from luxel.textures.store.files import lock
from luxel.textures.store.info import describe_baked
from luxel.textures.store.layout import BakeSettings, CodecChoice
from luxel.textures.store.source import StoredBaker
from luxel.textures.textures import decode
from tests.textures.stores import LIGHTS, SPEC, bake, hashes, some


@pytest.fixture(scope="module")
def finished(tmp_path_factory):
    """A finished store; copy it before changing anything."""
    path = tmp_path_factory.mktemp("store") / "a.zarr"
    bake(path)
    return path


@pytest.fixture
def store(finished, tmp_path):
    return shutil.copytree(finished, tmp_path / "b.zarr")


# what comes out


@pytest.mark.parametrize("offset", [0.0, 1e9])
def test_particles_come_back_bit_for_bit(tmp_path, offset):
    given = some(offset=offset)
    found = bake(tmp_path / "a.zarr", given)[0].particles
    assert np.array_equal(found.local, given.local)
    assert np.array_equal(found.origin, given.origin)
    assert np.array_equal(found.radii, given.radii)
    assert list(found.scalars) == list(given.scalars)
    for name, values in given.scalars.items():
        assert np.array_equal(found.scalars[name], values)
        assert found.scalars[name].dtype == values.dtype.newbyteorder("=")
    assert found.categories == given.categories
    assert (found.time, found.radii_source) == (given.time, given.radii_source)
    assert np.array_equal(found.cell.vectors, given.cell.vectors)
    assert found.cell.periodic == given.cell.periodic


@pytest.mark.parametrize("mode", ["paper", "fast"])
def test_textures_are_those_of_a_bake_in_memory(tmp_path, mode):
    spec = luxel.TextureSpec(samples=4, mode=mode, seed=3, mapping="octahedral")
    scene = luxel.Scene(some(), LIGHTS, "shadows")
    frame = luxel.bake_to(tmp_path / "a.zarr", scene, spec=spec, chunk=3)[0]
    expected = luxel.bake(scene, samples=4, mode=mode, seed=3, mapping="octahedral")
    assert np.array_equal(frame.textures.codes, expected.codes)
    assert np.array_equal(frame.textures.luminance, expected.luminance)
    assert np.array_equal(frame.errors, expected.errors)
    assert (frame.key, frame.clipped_count) == (expected.key, expected.clipped_count)
    assert frame.scene.key == scene.key
    assert (frame.textures.snapshot(frame.key).slot == np.arange(10)).all()


def test_pictures_are_those_of_textures_in_memory(tmp_path):
    scene = luxel.Scene(some(), LIGHTS)
    frame = luxel.bake_to(tmp_path / "a.zarr", scene, spec=luxel.TextureSpec(samples=4))[0]
    view = luxel.View(color_by="vector")
    expected = luxel.render(scene, view, luxel.bake(scene, samples=4), size=(40, 30))
    found = luxel.render(frame.scene, view, frame.textures, size=(40, 30))
    assert np.array_equal(found.pixels, expected.pixels)


def test_settings_go_through_json():
    lights = (*LIGHTS, SphereLight((1, 2, 3), 0.5), QuadLight((0, 0, 0), (1, 0, 0), (0, 1, 0), level=3))
    scene = luxel.Scene(some(), lights, "ao", ao_distance=0.3, periodic="yx", periodic_images=2)
    settings = BakeSettings.of(scene, SPEC, codec=CodecChoice("vq", codewords=7), frames=(2, 5), up="y")
    stored = json.loads(json.dumps(settings.to_json()))
    again = BakeSettings.from_json(stored)
    assert again.to_json() == settings.to_json()
    assert again.scene(scene.particles).key == scene.key


def test_frames(tmp_path):
    series = [some(seed=k) for k in range(4)]
    baked = bake(tmp_path / "a.zarr", series, frames=[1, -1])
    assert [frame.source_frame for frame in baked] == [1, 3]
    assert [particles.time for particles in baked.series] == [1.1, 3.1]
    assert np.array_equal(baked[-1].particles.local, series[3].local)
    expected = bake(tmp_path / "b.zarr", series[3])[0]
    assert np.array_equal(baked[1].textures.codes, expected.textures.codes)
    with pytest.raises(FrameError, match=r"no frame 2 — frames are 0\.\.1"):
        baked[2]
    with pytest.raises(FrameError, match="there are 4"):
        bake(tmp_path / "c.zarr", series, frames=[4])
    with pytest.raises(InputError, match="no frames"):
        bake(tmp_path / "c.zarr", series, frames=[])


def test_every_chunk_is_written_even_if_all_is_dark(tmp_path):
    path = tmp_path / "a.zarr"
    baked = bake(path, lights=(Sky(0),))
    assert not baked[0].textures.codes.any()
    assert len(list(path.glob("frames/0000/payload/c/*/0"))) == 3


def test_other_programs_can_read_it(finished, tmp_path):
    code = """
import sys, json, zarr
store = zarr.open_group(sys.argv[1], mode="r")
frame = store["frames/0000"]
about = dict(store.attrs["luxel"])
payload = frame["payload"]
print(json.dumps({
    "luxel": any(name.partition(".")[0] == "luxel" for name in sys.modules),
    "complete": about["complete"], "version": about["version"], "mode": about["settings"]["spec"]["mode"],
    "scalars": [array.attrs["name"] for _, array in sorted(frame["scalars"].arrays())],
    "positions": frame["positions"][:].tolist(), "payload": payload[:].tolist(), "chunks": payload.chunks,
    "codecs": [type(codec).__name__ for codec in payload.metadata.codecs],
}))
"""
    done = subprocess.run(
        [sys.executable, "-I", "-c", code, str(finished)],
        capture_output=True,
        text=True,
        timeout=120,
        check=False,
        cwd=tmp_path,
    )
    assert done.returncode == 0, done.stderr
    assert done.stderr == ""
    found = json.loads(done.stdout)
    frame = luxel.open_baked(finished)[0]
    assert found["luxel"] is False
    assert (found["complete"], found["version"], found["mode"]) == (True, 1, "paper")
    assert found["scalars"] == list(some().scalars)
    assert found["positions"] == frame.particles.local.tolist()
    assert np.array_equal(np.array(found["payload"]).reshape(-1, 4, 4), frame.textures.codes)
    assert found["chunks"] == [4, 16]
    assert "Crc32cCodec" in found["codecs"]


def test_description(finished):
    (frame,) = describe_baked(luxel.open_baked(finished))["frames"]
    assert (frame["particles"], frame["raw_bytes"], frame["payload_bytes"], frame["ratio"]) == (
        10,
        160,
        160,
        1,
    )
    assert 0 <= frame["error_mean"] <= frame["error_max"]


# codecs


def test_what_the_codec_changed_is_measured(tmp_path):
    baked = bake(tmp_path / "a.zarr", some(40), codec=CodecChoice("vq", codewords=6), keep_raw=True)
    frame = baked[0]
    raw = zarr.open_array(tmp_path / "a.zarr/frames/0000/raw", mode="r")[:]
    assert np.array_equal(raw, bake(tmp_path / "b.zarr", some(40))[0].textures.codes)
    assert np.array_equal(frame.original()[3:7], raw[3:7])
    difference = frame.textures.codes.astype(float) - raw
    found = frame.distortion
    assert found["d"] == pytest.approx((difference**2).sum(axis=(1, 2)).mean())
    assert found["root_d"] == pytest.approx(found["d"] ** 0.5)
    assert found["rmse"] == pytest.approx(np.sqrt((difference**2).mean()))
    assert found["psnr"] == pytest.approx(20 * np.log10(255 / found["rmse"]))
    assert found["largest"] == np.abs(difference).max()
    light = decode(raw, frame.scale, frame.encoding).astype(float)
    error = light - frame.textures.luminance
    angles = luxel.texel_solid_angles("latlong", 4) / (4 * np.pi)
    assert found["surface"] == pytest.approx(np.sqrt((error**2 * angles).sum() / 40))
    assert found["seen"] == pytest.approx(np.sqrt((error**2 * light * angles).sum() / (light * angles).sum()))
    assert found["largest_luminance"] == pytest.approx(np.abs(error).max())
    assert found["ratio"] == pytest.approx(raw.size / (40 * frame.payload_bytes + frame.shared_bytes))
    assert frame.payload.shape == (40, frame.codec.payload_bytes)


def test_encoding_a_raw_store_is_baking_with_that_codec(tmp_path, finished):
    choice = CodecChoice("vq", codewords=3)
    bake(tmp_path / "a.zarr", codec=choice)
    encoded = luxel.encode_to(tmp_path / "b.zarr", luxel.open_baked(finished), choice)
    assert hashes(tmp_path / "b.zarr") == hashes(tmp_path / "a.zarr")
    assert not (tmp_path / "b.zarr/frames/0000/raw").exists()
    back = luxel.encode_to(tmp_path / "c.zarr", encoded, "raw")
    assert np.array_equal(back[0].textures.codes, encoded[0].textures.codes)
    with pytest.raises(InputError, match="into itself"):
        luxel.encode_to(tmp_path / "b.zarr", encoded, "raw")


def test_codec_options():
    assert CodecChoice("vq").ratio == 4
    assert CodecChoice("vq", error=2.0).options == {"error": 2.0}
    with pytest.raises(InputError, match="codec raw keeps every texel: ratio"):
        CodecChoice("raw", ratio=4)
    with pytest.raises(InputError, match="codewords must be a positive number"):
        CodecChoice("vq", codewords=0)


# as an engine's baker, and in a session


def test_a_session_serves_what_is_stored(tmp_path):
    baked = bake(tmp_path / "a.zarr", [some(seed=k) for k in range(2)], frames=[0, 1])
    with luxel.Session(baked, threads=0) as session:
        for k, frame in enumerate(baked):
            key = session.set_frame(k)
            assert key == frame.key
            session.sighted([1, 4, 9], (5, 5, 5))
            session.run_for(60)
            found = session.tiles([1, 4, 9])
            assert found.ids.tolist() == [1, 4, 9]
            assert np.array_equal(found.codes, frame.textures.codes[[1, 4, 9]])
            expected = luxel.render(frame.scene, textures=frame.textures, size=(24, 16))
            session.sighted(np.arange(10), (5, 5, 5))
            session.run_for(60)
            shown = luxel.render(session.scene, textures=session.source, size=(24, 16))
            assert np.array_equal(shown.pixels, expected.pixels)
        with pytest.raises(InputError, match="is baked in"):
            session.relight(albedo=0.1)


def test_first_light_of_a_lone_particle_under_a_gradient(tmp_path):
    baked = bake(
        tmp_path / "a.zarr",
        luxel.Particles([[0, 0, 0]], 1),
        lights=(Sky(1.0, ground=0.0),),
        spec=luxel.TextureSpec(samples=100),
    )
    (record,) = StoredBaker(baked[0]).first_light(np.array([0], np.int32))
    np.testing.assert_allclose(record, [0.5, 0, 0, 1 / 3], atol=0.01)


# damage


def damaged(path, match=None, read=lambda frame: frame.textures):
    with pytest.raises(FormatError, match=match) as caught:
        read(luxel.open_baked(path)[0])
    message = str(caught.value)
    assert str(path) in message
    assert " — " in message
    return message


@pytest.mark.parametrize(
    "name", ["payload/c/1/0", "radii/c/0", "positions/c/0/0", "scalars/001/c/0", "errors/c/2"]
)
@pytest.mark.parametrize("how", ["flip", "truncate", "empty", "remove"])
def test_a_damaged_chunk_is_noticed(store, name, how):
    file = store / "frames/0000" / name
    content = bytearray(file.read_bytes())
    content[len(content) // 2] ^= 1
    if how == "remove":
        file.unlink()
    else:
        file.write_bytes({"flip": content, "truncate": content[:-3], "empty": b""}[how])

    def read(frame):
        return frame.particles, frame.textures

    assert name.partition("/c/")[0] in damaged(store, "missing|cannot be read", read)


@pytest.mark.parametrize("name", ["frames/0000/zarr.json", "frames/0000/payload/zarr.json", "zarr.json"])
@pytest.mark.parametrize("content", [b"", b"{", b"[]", b"{}", None])
def test_damaged_metadata_is_noticed(store, name, content):
    if content is None:
        (store / name).unlink()
    else:
        (store / name).write_bytes(content)
    damaged(store)


def test_lying_settings_are_noticed(store):
    change(store, lambda header: header["settings"]["spec"].update(samples=3))
    damaged(store, "square")


def change(store, edit):
    data = json.loads((store / "zarr.json").read_text())
    edit(data["attributes"]["luxel"])
    (store / "zarr.json").write_text(json.dumps(data))


def test_another_version_is_refused(store):
    change(store, lambda header: header.update(version=99))
    damaged(store, "version 99; this luxel reads version 1")
    with pytest.raises(FormatError, match="version 99"):
        bake(store)
    bake(store, overwrite=True)
    assert luxel.open_baked(store)[0].count == 10


def test_an_unfinished_store_is_refused(store):
    change(store, lambda header: header.update(complete=False))
    damaged(store, "not finished — run the same")


def test_foreign_places(tmp_path):
    zarr.create_group(tmp_path / "foreign.zarr")
    zarr.create_array(tmp_path / "array.zarr", shape=3, dtype="u1")
    (tmp_path / "plain.zarr").mkdir()
    (tmp_path / "plain.zarr/precious.txt").write_text("mine")
    (tmp_path / "file.zarr").write_text("mine")
    for name in ("foreign", "array", "plain", "file"):
        path = tmp_path / f"{name}.zarr"
        damaged(path)
        for overwrite in (False, True):
            with pytest.raises(LuxelError, match=r"another -o|another path"):
                bake(path, overwrite=overwrite)
    assert (tmp_path / "plain.zarr/precious.txt").read_text() == "mine"
    assert (tmp_path / "file.zarr").read_text() == "mine"
    with pytest.raises(MissingFileError, match="no such store — luxel bake FILE -o"):
        luxel.open_baked(tmp_path / "nothing.zarr")
    with pytest.raises(StorageError, match="make it first"):
        bake(tmp_path / "nowhere/a.zarr")
    with pytest.raises(FormatError, match="open_baked"):
        luxel.open(tmp_path / "foreign.zarr")


# another bake


def test_a_finished_store_is_left_alone(store):
    before = {file: file.stat().st_mtime_ns for file in store.rglob("*") if file.is_file()}
    seen = []
    bake(store, progress=lambda *report: seen.append(report))
    assert seen == []
    assert {file: file.stat().st_mtime_ns for file in store.rglob("*") if file.is_file()} == before


@pytest.mark.parametrize(
    "options, what",
    [
        ({"spec": luxel.TextureSpec(4, 4)}, "settings.spec.samples is 1 in the store and 4 here"),
        ({"albedo": 0.5}, "settings.albedo is 0.7 in the store and 0.5 here"),
        ({"lights": (Sun((0, 0, 1)),)}, "settings.lights"),
        ({"codec": "vq"}, "settings.codec.kind"),
        ({"periodic": "x"}, "settings.periodic"),
        ({"chunk": 5}, "settings.chunk"),
        ({"particles": some(seed=1)}, "positions and radii"),
        ({"particles": some().with_radii(0.3)}, "positions and radii"),
    ],
)
def test_another_bake_is_never_mixed_in(store, options, what):
    before = hashes(store)
    with pytest.raises(InputError) as caught:
        bake(store, **options)
    message = str(caught.value)
    assert what in message
    assert str(store) in message
    assert "--overwrite" in message
    assert hashes(store) == before
    if not options.keys() & {"particles", "periodic"}:  # kernels for periodic cells take long to compile
        bake(store, **options, overwrite=True)


def test_only_scalars_differ(store):
    given = some()
    other = luxel.Particles(given.positions, given.radii, cell=given.cell, time=given.time)
    with pytest.raises(InputError, match=r"their scalars, cell and time differ"):
        bake(store, other)


def test_overwriting_leaves_nothing_behind(store, tmp_path):
    bake(store, some(3, seed=5), chunk=2, overwrite=True)
    bake(tmp_path / "new.zarr", some(3, seed=5), chunk=2)
    assert hashes(store) == hashes(tmp_path / "new.zarr")


def test_two_bakes_at_once(store):
    with lock(store), pytest.raises(StorageError, match="another process is baking into this store"):
        bake(store)
    bake(store)  # the lock is gone
    assert not (store / ".luxel.lock").exists()
