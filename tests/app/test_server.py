"""The viewer's server as a stranger and as a page meet it: over real sockets, with a baker that costs nothing."""

from __future__ import annotations

import http.client
import json
import socket
from collections.abc import Iterator
from pathlib import Path
from typing import Any
from urllib.parse import urlsplit

import numpy as np
import pytest

import luxel
from luxel.app import protocol
from luxel.app.limits import PAGES_MAX
from luxel.app.server import (
    CLIENT_FOLDER,
    CLOSE_BAD_MESSAGE,
    CLOSE_TOO_MANY,
    CLOSE_UNAUTHORISED,
    CLOSE_WRONG_VERSION,
)
from luxel.app.viewer import Viewer, view
from luxel.errors import InputError
from luxel.scene.lights import Sky, SphereLight, Sun, sun_direction
from luxel.session import Session
from luxel.textures.codecs import restore
from luxel.textures.spec import TextureSpec
from luxel.textures.store.bake import bake_to
from luxel.textures.store.layout import CodecChoice
from luxel.trace.spheres import SphereSet
from tests.app.socket_client import GUARD_S, Client, InstantBaker
from tests.scenes import cloud

COUNT = 6000  # more than the tiles of four full messages, 1024 each
TEXELS = 4


@pytest.fixture
def viewer() -> Iterator[Viewer]:
    frames = [cloud(COUNT), cloud(COUNT // 2, seed=1)]
    spec = TextureSpec(texels=TEXELS, samples=1)
    lights = (Sky(1.0), Sun(sun_direction(195.0, 50.0), level=2.0))
    with Session(
        frames, lights=lights, spec=spec, threads=1, make_baker=lambda scene, spec: InstantBaker()
    ) as session:
        opened = view(session, block=False, open_browser=False, announce=lambda url: None)
        with opened:
            yield opened


def get(viewer: Viewer, path: str, **headers: str) -> tuple[http.client.HTTPResponse, str]:
    where = urlsplit(viewer.url)
    connection = http.client.HTTPConnection("127.0.0.1", where.port, timeout=30)
    connection.putrequest("GET", path, skip_host="Host" in headers)
    for name, value in headers.items():
        connection.putheader(name, value)
    connection.endheaders()
    response = connection.getresponse()
    text = response.read().decode()
    connection.close()
    return response, text


def token_path(viewer: Viewer) -> str:
    return f"/?{urlsplit(viewer.url).query}"


def test_page_and_modules_need_the_token(viewer: Viewer) -> None:
    for path in ("/", "/?token=guess", "/client/page.js", "/favicon.ico", "/nothing"):
        response, text = get(viewer, path)
        assert response.status == 403
        assert "token" in text
    response, text = get(viewer, token_path(viewer))
    assert response.status == 200
    assert "<canvas" in text
    cookie = response.headers["Set-Cookie"]
    assert "HttpOnly" in cookie
    assert "samesite=strict" in cookie.lower()
    given = cookie.split(";")[0]
    for each in CLIENT_FOLDER.iterdir():
        response, text = get(viewer, f"/client/{each.name}", Cookie=given)
        assert response.status == 200, each.name
        assert text == each.read_text()
    assert get(viewer, "/client/page.js", Cookie=given[:-2])[0].status == 403


def test_nothing_outside_the_folder_is_served(viewer: Viewer) -> None:
    query = urlsplit(viewer.url).query
    for name in ("..", "../server.py", "..%2fserver.py", "%2e%2e/server.py", "nothing.js", "%00"):
        assert get(viewer, f"/client/{name}?{query}")[0].status == 404, name


def test_other_names_and_sites_are_refused(viewer: Viewer) -> None:
    port = urlsplit(viewer.url).port
    assert get(viewer, token_path(viewer), Host=f"evil.example:{port}")[0].status == 403
    assert get(viewer, token_path(viewer), Host=f"localhost:{port}")[0].status == 200
    assert get(viewer, token_path(viewer), Host="localhost:9999")[0].status == 200  # through a tunnel
    assert get(viewer, token_path(viewer), Origin="http://evil.example")[0].status == 403


def test_answers_carry_security_headers(viewer: Viewer) -> None:
    for path in (token_path(viewer), "/"):
        headers = get(viewer, path)[0].headers
        assert headers["Content-Security-Policy"].startswith("default-src 'self'")
        assert headers["X-Content-Type-Options"] == "nosniff"
        assert headers["Referrer-Policy"] == "no-referrer"
        assert headers["Cache-Control"] == "no-store"


@pytest.mark.parametrize(
    "options",
    [
        {"query": ""},
        {"query": "token=x"},
        {"origin": "http://evil.example", "suppress_origin": False},
        {"origin": "http://[", "suppress_origin": False},
    ],
)
def test_socket_needs_token_and_origin(viewer: Viewer, options: dict[str, Any]) -> None:
    code, reason = Client(viewer, hello=False, **options).closed()
    assert code == CLOSE_UNAUTHORISED
    assert reason


def test_socket_of_the_page_itself_is_let_in(viewer: Viewer) -> None:
    origin = f"http://{urlsplit(viewer.url).netloc}"
    assert Client(viewer, origin=origin, suppress_origin=False).next(protocol.SceneState).count == COUNT


def test_other_versions_are_told(viewer: Viewer) -> None:
    code, reason = Client(viewer, hello=False, subprotocols=["luxel.v0"]).closed()
    assert code == CLOSE_WRONG_VERSION
    assert protocol.SUBPROTOCOL in reason


def test_bad_messages_close_that_socket_only(viewer: Viewer) -> None:
    good = Client(viewer)
    key = good.next(protocol.LightState).key
    bad_ids = protocol.Sighted(key, np.array([COUNT], np.int32), (0, 0, 5))
    for say, hello in [
        (lambda c: c.socket.send("text"), True),
        (lambda c: c.socket.send_binary(b"\0" * 12), True),
        (lambda c: c.send(protocol.Confirm(0, 0, 0)), False),
        (lambda c: c.send(bad_ids), True),
    ]:
        client = Client(viewer, hello=hello)
        say(client)
        code, reason = client.closed()
        assert code == CLOSE_BAD_MESSAGE
        assert reason
    good.send(protocol.ScalarRequest("value"))
    assert good.next(protocol.Scalar).name == "value"


def test_more_pages_than_allowed_are_refused_and_the_others_stay(viewer: Viewer) -> None:
    clients = [Client(viewer) for _ in range(PAGES_MAX)]
    for client in clients:
        client.next(protocol.SceneState)
    code, reason = Client(viewer, hello=False).closed()
    assert code == CLOSE_TOO_MANY
    assert str(PAGES_MAX) in reason
    clients.pop().socket.close()
    clients[0].send(protocol.ColormapRequest("gray"))
    clients[0].next(protocol.Colormap)


def test_serving_beyond_this_machine_is_warned_about(caplog: pytest.LogCaptureFixture) -> None:
    with view(cloud(5), host="0.0.0.0", block=False, open_browser=False, announce=lambda url: None):
        assert "without encryption" in caplog.text
    caplog.clear()
    with view(cloud(5), block=False, open_browser=False, announce=lambda url: None):
        assert not caplog.text


def test_page_is_told_the_scene(viewer: Viewer) -> None:
    client = Client(viewer)
    scene = client.next(protocol.SceneState)
    light = client.next(protocol.LightState)
    part = client.next(protocol.Geometry)
    session = viewer.session
    spheres = SphereSet.of(session.particles)
    assert scene.count == COUNT
    assert scene.frame_count == 2
    assert [each["name"] for each in scene.scalars] == ["value", "vector", "vector.x", "vector.y", "vector.z"]
    np.testing.assert_array_equal(part.positions, spheres.centers)
    np.testing.assert_array_equal(part.radii, spheres.radii)
    assert light.key == session.key
    assert light.lighting == json.loads(json.dumps(luxel.Lighting.of(viewer.session.scene).to_json()))
    np.testing.assert_allclose(light.decoding[[0, 255]], [0.0, session.scale])


def test_tiles_come_for_what_is_sighted(viewer: Viewer) -> None:
    client = Client(viewer, confirms=True)
    key = client.next(protocol.LightState).key
    wanted = np.arange(10, 40, dtype=np.int32)
    client.send(protocol.Sighted(key, wanted, (0.0, 0.0, 5.0)))
    found: dict[int, int] = {}
    while len(found) < len(wanted):
        tiles = client.next(protocol.Tiles)
        assert tiles.key == key
        assert tiles.codes.shape == (len(tiles.ids), TEXELS, TEXELS)
        found.update(zip(tiles.ids.tolist(), tiles.codes[:, 0, 0].tolist(), strict=True))
    assert found == {k: k % 251 for k in wanted.tolist()}


def test_first_light_comes_before_tiles_and_only_once(viewer: Viewer) -> None:
    client = Client(viewer, confirms=True)
    light = client.next(protocol.LightState)
    wanted = np.arange(10, 2000, dtype=np.int32)
    client.send(protocol.Sighted(light.key, wanted, (0.0, 0.0, 5.0)))
    first = client.next(protocol.Coarse)
    assert not any(isinstance(each, protocol.Tiles) for each in client.heard)
    found: list[int] = first.ids.tolist()
    while len(found) < len(wanted):
        found += client.next(protocol.Coarse).ids.tolist()
    assert sorted(found) == wanted.tolist()
    assert first.key == light.key
    luminance = first.records.astype(np.float32) * light.decoding[255]
    np.testing.assert_allclose(luminance, np.repeat(first.ids[:, None] % 251, 4, axis=1), rtol=1e-3)
    viewer.session.wait(GUARD_S)
    client.send(protocol.Sighted(light.key, np.arange(1990, 2010, dtype=np.int32), (0.0, 0.0, 5.0)))
    assert sorted(client.next(protocol.Coarse).ids.tolist()) == list(range(2000, 2010))


def test_second_page_gets_what_is_ready_at_once_and_only_what_it_wants(viewer: Viewer) -> None:
    first, second = Client(viewer, confirms=True), Client(viewer)
    key = first.next(protocol.LightState).key
    second.next(protocol.Geometry)
    first.send(protocol.Sighted(key, np.arange(20, dtype=np.int32), (0, 0, 5)))
    got = 0
    while got < 20:
        got += len(first.next(protocol.Tiles).ids)
    second.send(protocol.Sighted(key, np.array([3, 4], np.int32), (0, 0, 5)))
    assert sorted(second.next(protocol.Tiles).ids.tolist()) == [3, 4]
    assert sum(isinstance(each, protocol.Tiles) for each in second.heard) == 1


def few_tiles_until_confirmed(viewer: Viewer, client: Client, key: str, *, beside: bool) -> None:
    """A page that confirms no tiles of a light gets a few thousand, and all as it confirms them."""
    client.send(protocol.Sighted(key, np.arange(COUNT, dtype=np.int32), (0, 0, 5)))
    client.next(protocol.Tiles)
    assert viewer.session.wait(30)
    client.send(protocol.ScalarRequest("value"))  # answered although tiles wait
    client.next(protocol.Scalar)

    def tiles() -> list[int]:
        found = [each for each in client.heard if isinstance(each, protocol.Tiles)]
        assert {each.beside for each in found} == {beside}
        return [len(each.ids) for each in found]

    assert 4 <= len(tiles()) <= 16
    assert sum(tiles()) <= 5 * 1024 < COUNT
    while sum(tiles()) < COUNT:
        count = len(tiles())
        client.send(protocol.Confirm(0, 1, 0, count) if beside else protocol.Confirm(count, 1))
        client.next(protocol.Tiles)
    assert sum(tiles()) == COUNT


def test_a_page_that_confirms_nothing_gets_few_tiles(viewer: Viewer) -> None:
    client = Client(viewer)
    few_tiles_until_confirmed(viewer, client, client.next(protocol.LightState).key, beside=False)


def test_scalars_and_colormaps_come_on_request(viewer: Viewer) -> None:
    client = Client(viewer)
    client.send(protocol.ScalarRequest("vector.y"))
    scalar = client.next(protocol.Scalar)
    values = viewer.session.particles.scalar("vector.y")
    np.testing.assert_array_equal(scalar.values, values.astype(np.float32))
    assert scalar.range == [values.min(), values.max()]
    client.send(protocol.ColormapRequest("viridis"))
    np.testing.assert_array_equal(client.next(protocol.Colormap).lut, luxel.View().lut())


@pytest.mark.parametrize(
    "message",
    [
        protocol.ScalarRequest("no such"),
        protocol.ColormapRequest("no such"),
        protocol.SetFrame(2),
        protocol.SetLight(model="no such"),
        protocol.Compare("no such"),
        protocol.SetLight(sun=(0.0, 91.0, 1.0, 15.0)),
        protocol.SetLight(sky=-1.0),
        protocol.SetLight(),
        protocol.SetLight(hide=[{"kind": "cut"}]),
        protocol.SetLight(hide=[{"kind": "select", "scalar": "strain"}]),
        protocol.SetLight(radius_scale=0.0),
        protocol.SetLight(sky=1.0, up="w"),
        protocol.SetLight(sun=(0.0, 1.0, 1.0, 1.0), up="w"),
        protocol.SetView({"exposure": -1}),
        protocol.SetView({"hide": [[]]}),
    ],
)
def test_wishes_that_cannot_be_granted_are_explained(viewer: Viewer, message: protocol.Message) -> None:
    client = Client(viewer)
    client.send(message)
    assert len(client.next(protocol.Error).text) > 10
    client.send(protocol.ScalarRequest("value"))
    client.next(protocol.Scalar)


def test_change_of_light_reaches_all_pages(viewer: Viewer) -> None:
    first, second = Client(viewer), Client(viewer)
    before = first.next(protocol.LightState)
    second.next(protocol.LightState)
    first.send(protocol.SetLight(sky=0.5, sun=(30.0, 20.0, 3.0, 10.0)))
    for client in (first, second):
        after = client.next(protocol.LightState)
        assert after.key == viewer.session.key != before.key
        sky, sun = after.lighting["lights"]
        assert sky["level"] == 0.5
        assert (sun["level"], sun["angular_diameter"]) == (3.0, 10.0)
        np.testing.assert_allclose(sun["direction"], sun_direction(30.0, 20.0))
    # A sighting under the old light crossed the change: nothing comes of it.
    first.send(protocol.Sighted(before.key, np.arange(5, dtype=np.int32), (0, 0, 5)))
    first.send(protocol.Sighted(after.key, np.array([7], np.int32), (0, 0, 5)))
    tiles = first.next(protocol.Tiles)
    assert tiles.key == after.key
    assert tiles.ids.tolist() == [7]


def test_two_lights_at_once_for_a_page_that_compares(viewer: Viewer) -> None:
    """The second light is told only to pages that asked, its tiles are marked, and it follows the first."""
    page, other = Client(viewer), Client(viewer)
    light = page.next(protocol.LightState)
    other.next(protocol.LightState)
    page.send(protocol.Compare("shadows"))
    beside = page.next(protocol.BesideState)
    assert (beside.model, beside.key) == ("shadows", viewer.session.key_beside)
    ids, eye = np.arange(10, 40, dtype=np.int32), (0.0, 0.0, 5.0)
    page.send(protocol.Sighted(light.key, ids, eye))
    page.send(protocol.Sighted(beside.key, ids + 5, eye))
    found: dict[tuple[str, bool], list[int]] = {(light.key, False): [], (beside.key, True): []}
    while min(map(len, found.values())) < len(ids):
        tiles = page.next(protocol.Tiles)
        found[tiles.key, tiles.beside] += tiles.ids.tolist()
    assert {key: sorted(each) for key, each in found.items()} == {
        (light.key, False): ids.tolist(),
        (beside.key, True): (ids + 5).tolist(),
    }
    page.send(protocol.SetLight(sky=0.25))
    assert page.next(protocol.BesideState).lighting["lights"][0]["level"] == 0.25
    page.send(protocol.SetFrame(1))
    page.next(protocol.SceneState)
    assert page.next(protocol.BesideState).key == viewer.session.key_beside
    page.send(protocol.Compare(None))
    page.send(protocol.ScalarRequest("value"))
    page.next(protocol.Scalar)
    assert viewer.session.key_beside is None
    other.send(protocol.ScalarRequest("value"))
    other.next(protocol.Scalar)
    assert not any(isinstance(each, protocol.BesideState) for each in other.heard)


def test_the_last_to_choose_what_to_compare_with_chooses_for_all_who_compare(viewer: Viewer) -> None:
    first, second = Client(viewer), Client(viewer)
    for client in (first, second):
        client.send(protocol.Compare("ao"))
        assert client.next(protocol.BesideState).model == "ao"
    second.send(protocol.Compare("lambertian"))
    assert first.next(protocol.BesideState).model == "lambertian"
    first.socket.close()
    second.send(protocol.ScalarRequest("value"))
    second.next(protocol.Scalar)
    assert viewer.session.scene_beside is not None  # the second page still compares


def test_a_page_that_confirms_no_tiles_of_the_second_light_gets_few(viewer: Viewer) -> None:
    client = Client(viewer)
    client.send(protocol.Compare("ao"))
    few_tiles_until_confirmed(viewer, client, client.next(protocol.BesideState).key, beside=True)


def test_other_lights_survive_the_sliders(viewer: Viewer) -> None:
    glow = SphereLight((0, 0, 3), 0.5, 4.0)
    viewer.session.relight(lights=(glow, Sky(1.0, ground=0.5), Sun((0, 0, 1)), Sun((1, 0, 0), level=0.25)))
    client = Client(viewer)
    assert len(client.next(protocol.LightState).globes) == 1
    client.send(protocol.SetLight(sky=2.0, sun=(0.0, 45.0, 1.0, 15.0)))
    client.next(protocol.LightState)
    lights = viewer.session.scene.sources
    assert lights[0] is glow
    assert isinstance(lights[1], Sky)
    assert (lights[1].level, lights[1].ground) == (2.0, 1.0)
    assert isinstance(lights[3], Sun)
    assert lights[3].level == 0.25


def test_change_of_frame_sends_the_new_particles(viewer: Viewer) -> None:
    client = Client(viewer)
    first = client.next(protocol.SceneState)
    client.send(protocol.SetFrame(1))
    second = client.next(protocol.SceneState)
    assert (second.frame, second.count) == (1, COUNT // 2)
    assert second.epoch != first.epoch
    while (part := client.next(protocol.Geometry)).epoch != second.epoch:
        pass
    assert len(part.radii) == COUNT // 2


def test_changes_made_in_python_reach_the_page(viewer: Viewer) -> None:
    client = Client(viewer)
    key = client.next(protocol.LightState).key
    viewer.session.relight(model="ao")
    light = client.next(protocol.LightState)
    assert light.model == "ao"
    assert light.key != key


def test_view_is_sent_as_it_is() -> None:
    particles = cloud(50)
    look = luxel.View(
        camera=luxel.Camera((3.0, 2.0, 1.0), (0.5, 0.5, 0.5), height=2.0), hide=luxel.Cut("x", 0.5)
    )
    session = Session(particles, threads=1, make_baker=lambda scene, spec: InstantBaker())
    opened = view(session, look, block=False, open_browser=False, announce=lambda url: None)
    with session, opened:
        sent = Client(opened).next(protocol.SceneState)
    assert sent.view == json.loads(json.dumps(look.to_json()))
    assert not sent.light_fixed


def test_hidden_from_light_and_radii_change_it_for_all_pages(viewer: Viewer) -> None:
    first, second = Client(viewer), Client(viewer)
    epoch = first.next(protocol.SceneState).epoch
    second.next(protocol.LightState)
    cut = luxel.Cut("x", 0.5)
    first.send(protocol.SetLight(hide=[cut.to_json()]))
    first.send(protocol.SetLight(radius_scale=1.5))
    for client in (first, second):
        while (light := client.next(protocol.LightState)).lighting["radius_scale"] == 1:
            pass
        assert light.lighting["hide"] == [json.loads(json.dumps(cut.to_json()))]
        assert light.key == viewer.session.key
    assert viewer.session.scene.conditions == (cut,)
    # Positions and radii stay what they were: the page scales and hides.
    client = Client(viewer)
    assert client.next(protocol.SceneState).epoch == epoch
    part = client.next(protocol.Geometry)
    np.testing.assert_array_equal(part.radii, SphereSet.of(viewer.session.particles.unscaled).radii)
    viewer.session.set_frame(1)
    assert len(viewer.session.particles) == COUNT // 2
    assert viewer.session.particles.radius_scale == 1.5


def test_a_page_of_another_up_axis_turns_sun_and_sky(viewer: Viewer) -> None:
    viewer.session.relight(lights=(Sky(1.0, ground=0.5), Sun((0, 0, 1))))
    client = Client(viewer)
    client.next(protocol.LightState)
    client.send(protocol.SetLight(sky=1.0, sun=(0.0, 90.0, 1.0, 15.0), up="y"))
    client.next(protocol.LightState)
    sky, sun = viewer.session.scene.sources
    np.testing.assert_allclose(sky.axis, [0, 1, 0], atol=1e-12)
    np.testing.assert_allclose(sun.direction, [0, 1, 0], atol=1e-12)


def test_a_saved_view_is_shown(viewer: Viewer) -> None:
    """Light and frame on all pages, the rest on the one that loads it."""
    first, second = Client(viewer), Client(viewer)
    second.next(protocol.LightState)
    look = luxel.View(color_by="value", exposure=2.0, hide=luxel.Select("value", 0.5))
    light = luxel.Lighting("ao", (Sky(0.5),), hide=luxel.Cut("y", 0.9), radius_scale=2.0)
    first.send(protocol.LoadView(luxel.SavedView(look, light, 1).to_json()))
    assert first.next(protocol.ViewState).view == json.loads(json.dumps(look.to_json()))
    assert second.next(protocol.SceneState).frame == 1
    assert second.next(protocol.LightState).key == viewer.session.key
    assert not any(isinstance(each, protocol.ViewState) for each in second.heard)
    now = luxel.Lighting.of(viewer.session.scene)
    assert now.to_json() == light.to_json()


@pytest.mark.parametrize(
    "saved, message",
    [
        ({"luxel_view": 9}, "version"),
        ({"luxel_view": 1, "light": {"model": "phong"}}, "model"),
        ({"luxel_view": 1, "view": {"color_by": "strain"}}, "strain"),
        ({"luxel_view": 1, "view": {"hide": [{"kind": "select", "scalar": "strain"}]}}, "strain"),
        ({"luxel_view": 1, "frame": 1, "light": {"radius_scale": -1}}, "radius scale"),
        ({"x": 1}, "no field x"),
    ],
)
def test_a_bad_saved_view_changes_nothing_and_says_why(
    viewer: Viewer, saved: dict[str, Any], message: str
) -> None:
    client = Client(viewer)
    key = client.next(protocol.LightState).key
    client.send(protocol.LoadView(saved))
    assert message in client.next(protocol.Error).text
    assert (viewer.session.key, viewer.session.frame) == (key, 0)


def test_a_view_of_a_later_frame_leaves_the_frame(viewer: Viewer) -> None:
    client = Client(viewer)
    client.send(protocol.LoadView(luxel.SavedView(luxel.View(exposure=3), None, 7).to_json()))
    assert client.next(protocol.ViewState).view["exposure"] == 3
    assert "frame 7" in client.next(protocol.Error).text
    assert viewer.session.frame == 0


def test_address_is_announced_once_and_works(viewer: Viewer) -> None:
    told: list[str] = []
    session = viewer.session
    with view(session, block=False, open_browser=False, announce=told.append) as second:
        assert told == [second.url]
        assert second.url.split("=")[1] != viewer.url.split("=")[1]
        assert get(second, token_path(second))[0].status == 200
    with pytest.raises(ConnectionRefusedError):
        get(second, "/")
    assert session.status().particles == COUNT  # a session that was given stays open


def test_wrong_use_is_refused(viewer: Viewer) -> None:
    with pytest.raises(InputError, match="model"):
        view(viewer.session, model="ao")
    taken = socket.create_server(("127.0.0.1", 0))
    with taken, pytest.raises(InputError, match="--port"):
        view(viewer.session, port=taken.getsockname()[1], block=False)


def test_baked_textures_come_whole_and_once(tmp_path: Path) -> None:
    spec = TextureSpec(mode="paper", samples=1, texels=TEXELS)
    baked = bake_to(
        tmp_path / "b.zarr",
        [cloud(50), cloud(30)],
        frames=[0, 1],
        spec=spec,
        model="shadows",
        codec=CodecChoice("pca", components=3),
    )
    with (
        Session(baked, threads=1) as session,
        view(session, block=False, open_browser=False, announce=lambda url: None) as viewer,
    ):
        client = Client(viewer)
        for frame, count in enumerate((50, 30)):
            if frame:
                client.send(protocol.SetFrame(frame))
            codec = client.next(protocol.CodecState)
            assert codec.key == client.last(protocol.LightState).key == session.key
            part = client.next(protocol.Payload)
            assert (part.key, part.start) == (codec.key, 0)
            assert part.records.shape == (count, codec.payload_bytes)
            arrays = {name: getattr(codec, name) for name in ("offset", "basis")}
            restored = restore(codec.description, arrays)
            np.testing.assert_array_equal(restored.decode(part.records), baked[frame].textures.codes)
            client.send(protocol.Sighted(codec.key, np.arange(count, dtype=np.int32), (0, 0, 5)))
        client.send(protocol.ColormapRequest("viridis"))
        client.next(protocol.Colormap)
        assert not any(isinstance(each, protocol.Tiles | protocol.Coarse) for each in client.heard)
        assert session.status().queued == 0


def test_a_bake_too_large_for_a_page_comes_as_tiles(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("luxel.app.baked._PAYLOAD_BYTES_MAX", 50)
    spec = TextureSpec(mode="paper", samples=1, texels=TEXELS)
    baked = bake_to(tmp_path / "b.zarr", cloud(50), spec=spec, model="shadows")
    with (
        Session(baked, threads=1) as session,
        view(session, block=False, open_browser=False, announce=lambda url: None) as viewer,
    ):
        client = Client(viewer)
        key = client.next(protocol.LightState).key
        client.send(protocol.Sighted(key, np.array([7], np.int32), (0, 0, 5)))
        tiles = client.next(protocol.Tiles)
        np.testing.assert_array_equal(tiles.codes, baked[0].textures.codes[7:8])
        assert not any(isinstance(each, protocol.CodecState) for each in client.heard)
