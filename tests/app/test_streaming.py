"""Streamed pictures and screenshots over real sockets."""

from __future__ import annotations

import io
from collections.abc import Iterator

import numpy as np
import pytest
from PIL import Image

import luxel
from luxel.app import protocol
from luxel.app.download import Download
from luxel.app.server import CLOSE_BAD_MESSAGE
from luxel.app.viewer import Viewer, view
from luxel.session import Session
from luxel.textures.spec import TextureSpec
from luxel.trace.spheres import SphereSet
from tests.app.socket_client import Client
from tests.scenes import cloud

pytestmark = pytest.mark.usefixtures("warm")

SIZE = (96, 72)
SPEC = TextureSpec(mode="paper", samples=1, texels=8)
FRAMES = [cloud(300), cloud(200, seed=1)]


@pytest.fixture
def viewer() -> Iterator[Viewer]:
    with (
        Session(FRAMES, model="shadows", spec=SPEC, threads=1) as session,
        view(
            session, renderer="raytrace", block=False, open_browser=False, announce=lambda url: None
        ) as opened,
    ):
        yield opened


def look(azimuth: float = -60.0) -> luxel.View:
    return luxel.View(camera=luxel.Camera.framing(FRAMES[0].bounds, azimuth=azimuth), color_by="value")


def stream(look: luxel.View, *, moving: bool = False) -> protocol.Stream:
    return protocol.Stream(look.to_json(), *SIZE, moving)


def watch(client: Client, message: protocol.Stream) -> protocol.StreamedFrame:
    """Ask for a view, confirm what comes, and return the last picture."""
    client.send(message)
    shown = None
    while True:
        frame = client.next(protocol.StreamedFrame)
        client.send(protocol.ConfirmFrame(frame.frame))
        shown = frame if len(frame.image) else shown
        if frame.final:
            assert shown is not None
            return shown


def pixels(data: np.ndarray | bytes) -> np.ndarray:
    return np.asarray(Image.open(io.BytesIO(bytes(data))))


def ask_twice(client: Client) -> None:
    """Give the server time to say whatever it has to say."""
    for _ in range(2):
        client.send(protocol.Inspect(0))
        client.next(protocol.ParticleState)


def test_no_particles_are_sent_where_the_server_draws(viewer: Viewer) -> None:
    client = Client(viewer)
    assert client.next(protocol.SceneState).streamed
    client.send(protocol.ScalarRequest("value"))
    scalar = client.next(protocol.Scalar)
    assert len(scalar.values) == 0
    assert scalar.range[0] < scalar.range[1]
    shown = watch(client, stream(look()))
    expected = luxel.render(
        viewer.session.scene, look(), viewer.session.source, SIZE, colorbar=False, key=viewer.session.key
    )
    np.testing.assert_array_equal(pixels(shown.image), expected.pixels)
    assert shown.ready == shown.visible > 50
    kinds = {type(each) for each in client.heard}
    assert not kinds & {protocol.Geometry, protocol.Tiles, protocol.Coarse, protocol.Payload}


def test_each_page_says_who_draws_for_it(viewer: Viewer) -> None:
    own = Client(viewer, hello=False)
    own.send(protocol.Hello("own", "browser"))
    assert not own.next(protocol.SceneState).streamed
    own.next(protocol.Geometry)
    own.send(stream(look()))  # it draws by itself: no pictures
    ask_twice(own)
    own.send(protocol.DrawBy("server"))
    assert watch(own, stream(look())).lossless
    own.send(protocol.DrawBy("browser"))
    ask_twice(own)
    kinds = [type(each) for each in own.heard]
    assert kinds.count(protocol.SceneState) == kinds.count(protocol.Geometry) == 1  # it has them already

    other = Client(viewer)
    assert other.next(protocol.SceneState).streamed
    other.send(protocol.DrawBy("browser"))
    assert not other.next(protocol.SceneState).streamed
    other.next(protocol.Geometry)
    other.send(protocol.ScalarRequest("value"))
    assert len(other.next(protocol.Scalar).values) == 300


def test_new_light_and_frames_bring_new_pictures(viewer: Viewer) -> None:
    client = Client(viewer)
    session = viewer.session
    before = watch(client, stream(look()))
    client.send(protocol.SetLight(sky=0.25))
    dimmer = watch(client, stream(look()))
    assert pixels(dimmer.image).mean() < pixels(before.image).mean()
    client.send(protocol.SetFrame(1))
    assert client.next(protocol.SceneState).streamed
    shown = watch(client, stream(look()))
    expected = luxel.render(session.scene, look(), session.source, SIZE, colorbar=False, key=session.key)
    np.testing.assert_array_equal(pixels(shown.image), expected.pixels)
    session.relight(model="lambertian")  # from Python: the page has asked for nothing
    while not (frame := client.next(protocol.StreamedFrame)).final:
        client.send(protocol.ConfirmFrame(frame.frame))


def test_nothing_comes_once_the_picture_is_final_or_nobody_looks(viewer: Viewer) -> None:
    client = Client(viewer)
    watch(client, stream(look()))
    ask_twice(client)
    client.send(protocol.StopStream())
    client.send(protocol.SetLight(sky=0.5))
    client.next(protocol.LightState)
    client.send(protocol.SetLight(sky=1.0))
    client.next(protocol.LightState)
    ask_twice(client)
    frames = [each for each in client.heard if isinstance(each, protocol.StreamedFrame)]
    assert frames[-1].final
    client.send(stream(look(30.0)))
    assert not client.next(protocol.StreamedFrame).final


def test_picking_tells_where_the_particle_is(viewer: Viewer) -> None:
    client = Client(viewer)
    epoch = client.next(protocol.SceneState).epoch
    ids = luxel.render(
        viewer.session.scene, look(), viewer.session.source, SIZE, antialias=1, colorbar=False
    ).ids
    spheres = SphereSet.of(viewer.session.particles)
    for y, x in [*np.argwhere(ids >= 0)[::400], (0, 0)]:
        client.send(
            protocol.PickAt(look().to_json(), *SIZE, float((x + 0.5) / SIZE[0]), float((y + 0.5) / SIZE[1]))
        )
        picked = client.next(protocol.Picked)
        found = int(ids[y, x])
        assert (picked.epoch, picked.id) == (epoch, found)
        if found >= 0:
            np.testing.assert_array_equal(picked.center, spheres.centers[found].astype(float))
            assert picked.radius == spheres.radii[found]


def test_bad_views_are_told_and_bad_sizes_close_the_socket(viewer: Viewer) -> None:
    client = Client(viewer)
    client.send(protocol.Stream({"exposure": 0}, *SIZE))
    assert "exposure" in client.next(protocol.Error).text
    client.send(protocol.TakeScreenshot({"colour": 1}, 40, 30))
    assert "colour" in client.next(protocol.Error).text
    assert client.next(protocol.ScreenshotState).total == 0
    assert watch(client, stream(look())).lossless
    client.send(protocol.Stream({}, 9000, 9000))
    code, reason = client.closed()
    assert code == CLOSE_BAD_MESSAGE
    assert "width" in reason


def screenshot(client: Client, size: tuple[int, int]) -> bytes:
    client.send(protocol.TakeScreenshot(look().to_json(), *size))
    data = b""
    parts = 0
    while True:
        part = client.next(protocol.ScreenshotPart)
        parts += 1
        assert part.start == len(data)
        data += part.data.tobytes()
        client.send(protocol.ConfirmParts(parts))
        if len(data) == part.size:
            return data


def test_screenshots_have_any_size_and_the_light_that_there_is(viewer: Viewer) -> None:
    client = Client(viewer)
    watch(client, stream(look()))
    session = viewer.session
    for size in ((200, 150), (1, 700)):
        picture = pixels(screenshot(client, size))
        expected = luxel.render(session.scene, look(), session.source, size, key=session.key)
        np.testing.assert_array_equal(picture, expected.pixels)
        client.send(protocol.ConfirmParts(0))  # a lie that asks for nothing
    reports = [each for each in client.heard if isinstance(each, protocol.ScreenshotState)]
    assert reports[-1].done <= reports[-1].total


def test_one_screenshot_a_page_at_a_time_which_can_be_cancelled(viewer: Viewer) -> None:
    client = Client(viewer)
    large = protocol.TakeScreenshot(look().to_json(), 8192, 4096)
    client.send(large)
    client.next(protocol.ScreenshotState)
    client.send(large)
    assert "already" in client.next(protocol.Error).text
    client.send(protocol.CancelScreenshot())
    assert len(screenshot(client, (32, 32))) > 0  # once the large one has let go


def test_downloads_wait_for_the_page() -> None:
    download = Download()
    assert download.take() is None
    data = np.random.default_rng(0).integers(0, 256, 6 << 20, dtype=np.uint8).tobytes()
    download.begin(data)
    parts = [download.take() for _ in range(4)]
    assert download.take() is None
    download.confirm(99)  # no page can have more than it was sent
    while (part := download.take()) is not None:
        parts.append(part)
    assert b"".join(part.data.tobytes() for part in parts if part is not None) == data
    assert {part.size for part in parts if part is not None} == {len(data)}
    download.confirm(6)
    download.begin(data)
    assert download.take() is not None
    download.begin(b"")  # cancelled
    assert download.take() is None


def test_unknown_renderers_are_refused() -> None:
    with pytest.raises(luxel.errors.InputError, match="raytrace"):
        view(cloud(5), renderer="magic", block=False, open_browser=False, announce=lambda url: None)  # type: ignore[arg-type]
