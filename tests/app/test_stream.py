"""Which pictures of a stream are drawn, in which size and format, and when."""

from __future__ import annotations

import io
import math
import threading
from collections.abc import Callable, Iterator
from typing import Any

import numpy as np
import pytest
from PIL import Image

import luxel
from luxel.app.frame_thread import FrameThread
from luxel.app.stream import PageStream
from luxel.app.stream_messages import PickAt, Stream, StreamedFrame
from luxel.errors import InputError, ScalarError
from luxel.picture.drawing import Crew
from luxel.session import Session
from luxel.textures.spec import TextureSpec
from luxel.textures.store.bake import bake_to
from luxel.textures.store.layout import CodecChoice
from tests.scenes import cloud

pytestmark = pytest.mark.usefixtures("warm")

SIZE = (96, 72)
GUARD_S = 20.0
SPEC = TextureSpec(mode="paper", samples=1, texels=8)
SCENE = luxel.Scene(cloud(300, spread=0.3), model="shadows")


@pytest.fixture
def session() -> Iterator[Session]:
    with Session(SCENE, spec=SPEC, threads=0) as made:
        yield made


def look(azimuth: float = -60.0, **changes: Any) -> luxel.View:
    camera = luxel.Camera.framing(SCENE.particles.bounds, azimuth=azimuth)
    return luxel.View(camera=camera, color_by="value", **changes)


def wish(view: luxel.View, *, moving: bool = False) -> Stream:
    return Stream(view.to_json(), *SIZE, moving)


def stream(session: Session, clock: Callable[[], float] = lambda: 0.0) -> PageStream:
    return PageStream(session, "page", Crew(1), clock)


def pixels(message: StreamedFrame) -> np.ndarray:
    return np.asarray(Image.open(io.BytesIO(message.image.tobytes())))


def play(page: PageStream, session: Session, most: int = 200) -> list[StreamedFrame]:
    """Step, and bake between steps, until nothing more comes."""
    heard = []
    for _ in range(most):
        message, wait_s = page.step()
        heard += [] if message is None else [message]
        if math.isinf(wait_s):
            return heard
        session.run_for(0.01)
    raise AssertionError(f"{most} steps and no end; heard {heard[-3:]}")


def test_while_it_moves_pictures_are_small_and_quick(session: Session) -> None:
    page = stream(session)
    page.show(wish(look(), moving=True))
    message, wait_s = page.step()
    assert message is not None
    assert (message.width, message.height) == (SIZE[0] // 2, SIZE[1] // 2)
    assert (message.lossless, message.final) == (False, False)
    assert message.image[:2].tobytes() == b"\xff\xd8"  # JPEG
    assert pixels(message).shape == (message.height, message.width, 3)
    assert math.isinf(wait_s)
    assert page.step() == (None, math.inf)  # light that comes meanwhile waits until the view rests
    page.show(wish(look(), moving=True))  # the same again: still a picture, since the page waits for one
    assert page.step()[0] is not None


def test_slow_pictures_become_smaller(session: Session) -> None:
    now = iter(float(k) for k in range(10_000))  # every look at the clock takes a second
    page = stream(session, lambda: next(now))
    page.show(wish(look(), moving=True))
    first = page.step()[0]
    page.show(wish(look(-50.0), moving=True))
    second = page.step()[0]
    assert first is not None
    assert second is not None
    assert second.width < first.width < SIZE[0]


def test_at_rest_the_last_picture_is_that_of_render(session: Session) -> None:
    page = stream(session)
    page.show(wish(look(), moving=True))
    page.step()
    page.show(wish(look()))
    heard = play(page, session)
    assert [each.frame for each in heard] == list(range(2, 2 + len(heard)))
    assert {(each.width, each.height) for each in heard} == {SIZE}
    assert heard[0].rays == 1
    assert not heard[0].lossless
    last = heard[-1]
    assert last.final
    assert last.lossless
    assert last.visible == last.ready > 100
    shown = next(each for each in reversed(heard) if len(each.image))
    assert shown.image[:4].tobytes() == b"\x89PNG"
    expected = luxel.render(SCENE, look(), session.source, SIZE, colorbar=False)
    np.testing.assert_array_equal(pixels(shown), expected.pixels)
    assert page.step() == (None, math.inf)


def test_helpers_without_time_keep_no_old_light(session: Session) -> None:
    """What they would have drawn is over; the last picture has all light nevertheless."""
    crew = Crew(2)
    crew.run(lambda: None)
    busy = threading.Event()
    assert crew._pool is not None
    crew._pool.submit(busy.wait)
    try:
        page = PageStream(session, "page", crew)
        page.show(wish(look()))
        heard = play(page, session, 2000)
    finally:
        busy.set()
        crew.close()
    assert heard[-1].ready == heard[-1].visible == session.status().ready


def test_new_colours_and_tone_need_no_light(session: Session) -> None:
    page = stream(session)
    page.show(wish(look()))
    play(page, session)
    baked = session.status().ready
    for changed in (look(colormap="magma"), look(exposure=2.0), look(background="#ffffff")):
        page.show(wish(changed))
        shown = next(each for each in reversed(play(page, session)) if len(each.image))
        assert shown.lossless
        expected = luxel.render(SCENE, changed, session.source, SIZE, colorbar=False)
        np.testing.assert_array_equal(pixels(shown), expected.pixels)
    assert session.status().ready == baked


def test_what_the_view_hides_is_not_there(session: Session) -> None:
    page = stream(session)
    cut = look(hide=(luxel.Cut("x", 0.5),))
    page.show(wish(cut))
    shown = next(each for each in reversed(play(page, session)) if len(each.image))
    expected = luxel.render(SCENE, cut, session.source, SIZE, colorbar=False)
    np.testing.assert_array_equal(pixels(shown), expected.pixels)
    assert (pixels(shown) != luxel.render(SCENE, look(), session.source, SIZE, colorbar=False).pixels).any()


def test_picking_finds_what_the_picture_shows(session: Session) -> None:
    page = stream(session)
    page.show(wish(look()))
    page.step()
    there = luxel.render(SCENE, look(), session.source, SIZE, antialias=1, colorbar=False).ids
    elsewhere = luxel.render(SCENE, look(100.0), session.source, SIZE, antialias=1, colorbar=False).ids
    for x, y in [(48, 36), (40, 30), (60, 40), (0, 0), (95, 71)]:
        at = ((x + 0.5) / SIZE[0], (y + 0.5) / SIZE[1])
        assert page.id_at(wish(look()), *at) == there[y, x]
        assert page.id_at(wish(look(100.0)), *at) == elsewhere[y, x]
    shown = next(each for each in reversed(play(page, session)) if len(each.image))
    expected = luxel.render(SCENE, look(), session.source, SIZE, colorbar=False)
    np.testing.assert_array_equal(pixels(shown), expected.pixels)  # the question has changed nothing


def test_views_that_make_no_sense_are_told(session: Session) -> None:
    page = stream(session)
    with pytest.raises(InputError, match="exposure"):
        page.show(Stream({"exposure": -1}, *SIZE))
    page.show(wish(look().with_changes(color_by="nothing")))
    with pytest.raises(ScalarError, match="nothing"):
        page.step()


@pytest.mark.parametrize("codec", [CodecChoice(), CodecChoice("pca", components=6)], ids=["raw", "pca"])
def test_baked_light_is_shown_as_it_is_stored(codec: CodecChoice, tmp_path: Any) -> None:
    frames = [cloud(200, seed=5), cloud(200, seed=6)]
    baked = bake_to(tmp_path / "b.zarr", frames, frames=[0, 1], model="shadows", spec=SPEC, codec=codec)
    with Session(baked, threads=0) as session:
        page = stream(session)
        for frame in (0, 1, 0):
            session.set_frame(frame)
            page.show(wish(look()))
            shown = next(each for each in reversed(play(page, session)) if len(each.image))
            stored = baked[frame]
            expected = luxel.render(stored.scene, look(), stored.compressed, SIZE, colorbar=False)
            np.testing.assert_array_equal(pixels(shown), expected.pixels)
        assert session.status().ready == 0  # nothing went through the cache


class Desk:
    """Hears what the thread says; waits for it."""

    def __init__(self, session: Session) -> None:
        self.heard: list[tuple[str, Any]] = []
        self.news = threading.Condition()
        self.thread = FrameThread(session, self.note, self.note, self.note)

    def note(self, page: str, what: Any) -> None:
        with self.news:
            self.heard.append((page, what))
            self.news.notify_all()

    def wait(self, page: str, count: int) -> list[Any]:
        """Wait until `count` things have been said to a page."""
        with self.news:
            assert self.news.wait_for(lambda: len(self.said(page)) >= count, GUARD_S), self.heard
            return self.said(page)

    def said(self, page: str) -> list[Any]:
        return [what for name, what in self.heard if name == page]


@pytest.fixture
def desk(session: Session) -> Iterator[Desk]:
    made = Desk(session)
    yield made
    made.thread.close()


def test_two_pictures_are_on_their_way_at_most(desk: Desk) -> None:
    desk.thread.watch("slow", wish(look()))
    desk.wait("slow", 2)
    for k in range(5):  # others go on meanwhile, and are served turn by turn
        desk.thread.watch("fast", wish(look(10.0 * k), moving=True))
        frames = desk.wait("fast", k + 1)
        desk.thread.confirm("fast", frames[-1].frame)
    assert len(desk.said("slow")) == 2
    desk.thread.watch("slow", wish(look(30.0), moving=True))
    desk.thread.watch("slow", wish(look(45.0), moving=True))
    desk.thread.confirm("slow", 2)
    third = desk.wait("slow", 3)[2]
    assert third.frame == 3
    shown = pixels(third).astype(int)
    source, size = desk.thread._session.source, (third.width, third.height)
    errors = {
        angle: np.abs(
            shown - luxel.render(SCENE, look(angle), source, size, antialias=1, colorbar=False).pixels
        ).mean()
        for angle in (45.0, 30.0, -60.0)
    }
    assert min(errors, key=errors.__getitem__) == 45.0, errors  # the newest view won


def test_a_page_cannot_confirm_what_it_was_not_sent(desk: Desk) -> None:
    desk.thread.watch("liar", wish(look()))
    desk.thread.confirm("liar", 10**9)
    desk.wait("liar", 2)
    desk.thread.pick("other", PickAt(look().to_json(), *SIZE, 0.5, 0.5))
    desk.wait("other", 1)
    desk.thread.pick("other", PickAt(look().to_json(), *SIZE, 0.0, 0.0))
    assert desk.wait("other", 2)[1] == -1
    assert len(desk.said("liar")) == 2


def test_failures_are_told_once_and_the_thread_lives(desk: Desk, monkeypatch: pytest.MonkeyPatch) -> None:
    bad = look().with_changes(color_by="nothing")
    desk.thread.watch("page", wish(bad))
    assert "nothing" in desk.wait("page", 1)[0]
    desk.thread.news()  # of light: no reason to try again
    desk.thread.pick("other", PickAt(look().to_json(), *SIZE, 0.0, 0.0))
    desk.wait("other", 1)
    assert len(desk.said("page")) == 1
    with monkeypatch.context() as patched:
        patched.setattr(PageStream, "step", lambda self: 1 / 0)
        desk.thread.watch("page", wish(look()))
        assert "log" in desk.wait("page", 2)[1]
    desk.thread.watch("page", wish(look()))
    assert isinstance(desk.wait("page", 3)[2], StreamedFrame)


def test_pages_that_leave_or_rest_get_nothing_more(desk: Desk, monkeypatch: pytest.MonkeyPatch) -> None:
    forgotten = threading.Event()
    monkeypatch.setattr(
        desk.thread._session, "forget", lambda client: forgotten.set() if "gone" in client else None
    )
    desk.thread.watch("gone", wish(look(), moving=True))
    desk.wait("gone", 1)
    desk.thread.forget("gone")
    assert forgotten.wait(GUARD_S)  # what only it wanted is no longer worth computing
    desk.thread.watch("resting", wish(look(), moving=True))
    desk.wait("resting", 1)
    desk.thread.rest("resting")
    desk.thread.confirm("resting", 1)
    desk.thread.news()
    desk.thread.watch("other", wish(look(), moving=True))
    desk.wait("other", 1)
    assert [len(desk.said(name)) for name in ("gone", "resting")] == [1, 1]


def test_the_thread_ends_with_the_session(session: Session) -> None:
    desk = Desk(session)
    desk.thread.watch("page", wish(look(), moving=True))
    desk.wait("page", 1)
    session.close()
    desk.thread.watch("page", wish(look(20.0), moving=True))
    desk.thread.close()
    assert desk.thread._thread is not None
    assert not desk.thread._thread.is_alive()
