"""Messages survive a round trip; anything else is refused with a reason, never with another exception."""

from __future__ import annotations

import contextlib
import json
import struct
from typing import get_args

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from luxel.app import protocol
from luxel.app.baked import PartFeed, part_size
from luxel.app.feed import Feed
from luxel.errors import ProtocolError

IDS = np.array([3, 1, 4], np.int32)
FROM_PAGE = [
    protocol.Hello("ANGLE"),
    protocol.Hello("none", "server"),
    protocol.Sighted("ab12", IDS, (0.5, -1.0, 2.0)),
    protocol.Confirm(7, 2, 5, 1),
    protocol.Compare("shadows"),
    protocol.Compare(None),
    protocol.SetLight("ao", 0.5, 1.25, (195.0, 50.0, 2.0, 15.0)),
    protocol.SetLight(sky=0.0),
    protocol.SetLight(up="y", hide=[{"kind": "cut", "normal": [1, 0, 0], "offset": 2}], radius_scale=1.5),
    protocol.SetView({"exposure": 2}),
    protocol.LoadView({"luxel_view": 1}),
    protocol.Inspect(7),
    protocol.SetFrame(3),
    protocol.ScalarRequest("velocity.x"),
    protocol.ScalarRequest("velocity.x", 2048, 4096),
    protocol.GeometryRequest(3, 2048, 4096),
    protocol.ColormapRequest("viridis"),
    protocol.Report("shader: 'x' undeclared"),
    protocol.DrawBy("server"),
    protocol.Stream({"exposure": 2}, 48, 32, True, (1.5, 0.5), 7),
    protocol.StopStream(),
    protocol.ConfirmFrame(3),
    protocol.PickAt({"exposure": 2}, 48, 32, 0.25, 1.0),
    protocol.TakeScreenshot({"exposure": 2}, 64, 48),
    protocol.CancelScreenshot(),
    protocol.ConfirmParts(4),
]
FROM_SERVER = [
    protocol.Geometry(1, 0, np.arange(6, dtype=np.float32).reshape(2, 3), np.ones(2, np.float32)),
    protocol.Scalar(1, "T", np.array([1, np.nan, 3], np.float32), (1.0, 3.0), (1.0, 3.0), False, True),
    protocol.Colormap("gray", np.arange(9, dtype=np.uint8).reshape(3, 3)),
    protocol.Tiles(
        "ab12", IDS, np.arange(3 * 16, dtype=np.uint8).reshape(3, 4, 4), np.array([0, 1, 0], np.uint8)
    ),
    protocol.Tiles("ab12", IDS, np.zeros((3, 4, 4), np.uint8), np.zeros(3, np.uint8), beside=True),
    protocol.Status("ab12", 1, 2, 3, 4, 5.5, None),
    protocol.Error("no such scalar"),
    protocol.ViewState({"exposure": 2}),
    protocol.ParticleState(1, 7, 9, "1, 2, 3", "0.5", [("T", "300")]),
    protocol.Coarse("ab12", IDS, np.arange(12, dtype=np.float16).reshape(3, 4)),
    protocol.CodecState(
        "ab12",
        {"kind": "pca", "texels": 4, "components": 3, "shift": 11},
        2048,
        3,
        2048,
        np.linspace(0, 1, 256, dtype=np.float32),
        offset=np.arange(16, dtype=np.int32),
        basis=np.arange(48, dtype=np.int16).reshape(16, 3),
        count=np.array([3], np.uint16),
        center=np.array([[-1]], np.int8),
    ),
    protocol.StreamedFrame(3, 7, "ab12", 48, 32, np.arange(5, dtype=np.uint8), True, 9, False, 7, 4, 1, 2),
    protocol.Picked(1, 7, (0.5, -0.5, 0.25), 0.125),
    protocol.ScreenshotState(1, 9),
    protocol.ScreenshotPart(0, 7, np.arange(7, dtype=np.uint8)),
    protocol.Payload("ab12", 2048, np.arange(6, dtype=np.uint8).reshape(2, 3)),
]


def test_every_message_of_a_page_is_tried_here() -> None:
    assert {type(message) for message in FROM_PAGE} == set(get_args(protocol.ClientMessage))


def same(a: protocol.Message, b: protocol.Message) -> None:
    assert type(a) is type(b)
    for name, value in vars(a).items():
        other = getattr(b, name)
        if isinstance(value, np.ndarray):
            assert other.dtype == value.dtype
            np.testing.assert_array_equal(other, value)
        else:
            assert json.dumps(other) == json.dumps(value), name


@pytest.mark.parametrize("message", FROM_PAGE, ids=lambda m: type(m).__name__)
def test_page_messages_survive(message: protocol.Message) -> None:
    same(message, protocol.decode_client(message.encode()))


@pytest.mark.parametrize("message", FROM_SERVER, ids=lambda m: type(m).__name__)
def test_server_messages_survive(message: protocol.Message) -> None:
    same(message, protocol.decode(message.encode()))


def test_arrays_start_at_multiples_of_four() -> None:
    """JavaScript can view an array in place only there."""
    for name in ("a", "ab", "abc", "abcd"):
        data = protocol.Colormap(name, np.zeros((3, 3), np.uint8)).encode()
        (length,) = struct.unpack_from("<I", data, 4)
        assert length % 4 == 0
        assert len(data) == 8 + length + 12


def test_numbers_that_json_lacks_are_not_sent() -> None:
    with pytest.raises(ValueError):
        protocol.Status("k", 0, 0, 0, 0, float("nan")).encode()


def message(kind: int, head: object, tail: bytes = b"") -> bytes:
    text = json.dumps(head).encode()
    text += b" " * (-len(text) % 4)
    return struct.pack("<B3xI", kind, len(text)) + text + tail


@pytest.mark.parametrize(
    "data",
    [
        b"",
        b"\x01\0\0\0",
        struct.pack("<B3xI", 1, 1 << 30),
        message(99, {}),
        message(16, {}),  # a server's message from a page
        message(1, []),
        message(1, {"renderer": 5}),
        message(1, {"renderer": "x" * 501}),
        message(2, {"key": "k", "eye": [0, 0, 0]}),
        message(2, {"key": "k", "eye": [0, 0], "arrays": {"ids": ["i4", [0]]}}),
        message(2, {"key": "k", "eye": [0, 0, "1"], "arrays": {"ids": ["i4", [0]]}}),
        message(2, {"key": "k", "eye": [0, 0, 10**400], "arrays": {"ids": ["i4", [0]]}}),
        message(2, {"key": "k", "eye": [0, 0, 0], "arrays": {"ids": ["f4", [1]]}}, bytes(4)),
        message(2, {"key": "k", "eye": [0, 0, 0], "arrays": {"ids": ["i4", [1, 1]]}}, bytes(4)),
        message(2, {"key": "k", "eye": [0, 0, 0], "arrays": {"ids": ["i4", [2]]}}, bytes(4)),
        message(2, {"key": "k", "eye": [0, 0, 0], "arrays": {"ids": ["i4", [1]]}}, bytes(8)),
        message(2, {"key": "k", "eye": [0, 0, 0], "arrays": {"ids": ["i4", [-1]]}}, bytes(4)),
        message(2, {"key": "k", "eye": [0, 0, 0], "arrays": {"ids": ["i4", [True]]}}, bytes(4)),
        message(2, {"key": "k", "eye": [0, 0, 0], "arrays": {"ids": ["i4", [2**30, 2**30, 2**30]]}}),
        message(2, {"key": "k", "eye": [0, 0, 0], "arrays": {"ids": ["O", [1]]}}, bytes(4)),
        message(2, {"key": "k", "eye": [0, 0, 0], "arrays": {"ids": [["i4"], [1]]}}, bytes(4)),
        message(2, {"key": "k", "eye": [0, 0, 0], "arrays": [1]}),
        message(3, {"batches": -1, "coarse": 0}),
        message(3, {"batches": True, "coarse": 0}),
        message(3, {"batches": 1.5, "coarse": 0}),
        message(3, {"batches": 1}),
        message(4, {"sky": "bright"}),
        message(4, {"sun": [1, 2, 3]}),
        message(5, {"frame": None}),
        message(5, {"frame": 0}, b"more"),
        message(1, {"renderer": "x", "by": "me"}),
        message(70, {"by": "both"}),
        message(70, {"by": ""}),
        message(71, {"view": {}, "width": 0, "height": 9, "moving": False, "grading": [1, 1], "wish": 0}),
        message(71, {"view": {}, "width": 8193, "height": 9, "moving": False, "grading": [1, 1], "wish": 0}),
        message(
            61, {"view": {}, "width": 4096, "height": 4096, "moving": False, "grading": [1, 1], "wish": 0}
        ),
        message(71, {"view": {}, "width": 9, "height": 9.5, "moving": False, "grading": [1, 1], "wish": 0}),
        message(71, {"view": {}, "width": 9, "height": 9, "moving": 1, "grading": [1, 1], "wish": 0}),
        message(71, {"view": {}, "width": 9, "height": 9, "moving": False, "grading": [1, -1], "wish": 0}),
        message(71, {"view": [], "width": 9, "height": 9, "moving": False, "grading": [1, 1], "wish": 0}),
        message(71, {"view": {}, "width": 9, "height": 9, "moving": False, "grading": [1, 1], "wish": -1}),
        message(74, {"view": {}, "width": 9, "height": 9, "x": 1.01, "y": 0}),
        message(74, {"view": {}, "width": 9, "height": 9, "x": 0, "y": -1}),
        message(75, {"view": {}, "width": 8193, "height": 1}),
        message(75, {"view": {}, "width": 1, "height": 0}),
        message(75, {"view": {"hide": [{}] * 65}, "width": 1, "height": 1}),
        struct.pack("<B3xI", 1, 16) + b'{"renderer":NaN}',
        struct.pack("<B3xI", 1, 4) + b"\xff\xff\xff\xff",
        struct.pack("<B3xI", 1, 400_000) + b"[" * 400_000,
        bytes(protocol.CLIENT_BYTES_MAX + 1),
    ],
)
def test_malformed_messages_are_refused(data: bytes) -> None:
    with pytest.raises(ProtocolError) as caught:
        protocol.decode_client(data)
    assert 5 < len(str(caught.value)) < 300


@settings(max_examples=300, deadline=None)
@given(st.binary(max_size=200))
def test_noise_is_refused(data: bytes) -> None:
    with pytest.raises(ProtocolError):
        protocol.decode_client(data)


JSON = st.recursive(
    st.none() | st.booleans() | st.integers() | st.floats() | st.text(max_size=9),
    lambda inner: st.lists(inner, max_size=4) | st.dictionaries(st.text(max_size=9), inner, max_size=4),
    max_leaves=8,
)
NAMES = st.sampled_from(
    ["key", "eye", "batches", "coarse", "model", "sky", "sun", "frame", "name", "text", "renderer", "arrays"]
)


@settings(max_examples=300, deadline=None)
@given(st.integers(0, 255), st.dictionaries(NAMES, JSON, max_size=5), st.binary(max_size=16))
def test_only_good_messages_or_protocol_errors_come_out(
    kind: int, head: dict[str, object], tail: bytes
) -> None:
    try:
        found = protocol.decode_client(message(kind, head, tail))
    except ProtocolError:
        return
    same(found, protocol.decode_client(found.encode()))


@settings(max_examples=200, deadline=None)
@given(st.sampled_from(FROM_PAGE), st.data())
def test_damaged_messages_raise_nothing_else(good: protocol.Message, data: st.DataObject) -> None:
    raw = bytearray(good.encode())
    for _ in range(data.draw(st.integers(1, 4))):
        raw[data.draw(st.integers(0, len(raw) - 1))] = data.draw(st.integers(0, 255))
    cut = bytes(raw[: data.draw(st.integers(0, len(raw)))])
    for damaged in (bytes(raw), cut):
        with contextlib.suppress(ProtocolError):  # anything else fails the test
            protocol.decode_client(damaged)


def drain(feed: Feed) -> list[int]:
    sent: list[int] = []
    while (batch := feed.take()) is not None:
        sent += batch.tolist()
    return sent


def test_feed_sends_each_wanted_tile_once() -> None:
    feed = Feed()
    feed.reset(100)
    feed.want(np.array([5, 6, 7], np.int32))
    assert feed.publish(np.array([6, 50], np.int32))
    assert not feed.publish(np.array([51], np.int32))
    assert drain(feed) == [6]
    feed.want(np.array([5, 6, 7], np.int32))  # asked again before the page could have it
    feed.publish(np.array([5, 6, 7], np.int32))
    assert drain(feed) == [5, 7]
    feed.confirm(2)
    feed.want(np.array([6], np.int32))  # the page gave it up since
    feed.publish(np.array([6], np.int32))
    assert drain(feed) == [6]


def test_feed_waits_for_confirmation() -> None:
    feed = Feed()
    feed.reset(100_000)
    ids = np.arange(100_000, dtype=np.int32)
    feed.want(ids)
    feed.publish(ids)
    first = drain(feed)
    assert 0 < len(first) < len(ids)
    assert feed.take() is None
    feed.confirm(1)
    second = drain(feed)
    assert len(second) == len(first) // 4
    for confirmed in range(2, 200):
        feed.confirm(confirmed)
        second += drain(feed)
    assert first + second == ids.tolist()


def test_small_messages_do_not_use_the_window_up() -> None:
    feed = Feed(64)
    feed.reset(100_000)
    feed.want(np.arange(100_000, dtype=np.int32))
    sizes, ready = [], 0
    for small in range(600):  # a page that confirms nothing, and one texture after the other
        feed.publish(np.array([small], np.int32))
        ready += 1
        if (batch := feed.take()) is not None:
            sizes.append(len(batch))
            ready -= len(batch)
            assert ready == 0
    # At once at first, then as much as is on its way, then whole messages; never much more than four of these.
    assert sizes == [1, 1, 1, 1, 4, 8, 16, 32, 64, 64, 64]
    feed.confirm(11)
    batch = feed.take()
    assert batch is not None
    assert len(batch) == 64


def test_a_page_that_stalls_gets_few_messages_however_often_the_light_changes() -> None:
    feed = Feed()
    count = 0
    for _ in range(100):
        feed.reset(10)
        feed.want(np.arange(10, dtype=np.int32))
        feed.publish(np.arange(10, dtype=np.int32))
        count += feed.take() is not None
    assert 4 <= count <= 16


def test_feed_sends_what_the_page_keeps_once_only() -> None:
    feed = Feed(2, once=True)
    feed.reset(10)
    feed.want(np.array([1, 2, 3], np.int32))
    feed.publish(np.array([1, 2, 3], np.int32))
    assert [each.tolist() for each in (feed.take(), feed.take())] == [[1, 2], [3]]
    feed.confirm(2)
    feed.want(np.array([2, 3, 4], np.int32))
    feed.publish(np.array([2, 3, 4], np.int32))
    assert drain(feed) == [4]
    feed.reset(10)  # another light
    feed.want(np.array([2], np.int32))
    feed.publish(np.array([2], np.int32))
    assert drain(feed) == [2]


def test_coarse_records_keep_their_luminance() -> None:
    records = np.array([[0, 0, 0, 0], [1e-3, -1, 2, 0.5], [3e4, -3e4, 0, 1]], np.float32)
    for scale in (1e-6, 1.0, 4e5):
        sent = protocol.decode(protocol.Coarse.of("k", IDS, records * np.float32(scale), scale).encode())
        assert isinstance(sent, protocol.Coarse)
        np.testing.assert_allclose(sent.records.astype(np.float32), records, rtol=1e-3)
        assert np.isfinite(sent.records).all()
    assert np.isfinite(protocol.Coarse.of("k", IDS, records, 1e-3).records).all()


def test_feed_sends_an_estimate_once_and_then_what_is_better() -> None:
    feed = Feed()
    feed.reset(10)
    wanted, rough = np.array([1, 2, 3], np.int32), np.array([True, True, False])
    feed.want(wanted)
    feed.publish(wanted, rough)
    assert feed.take().tolist() == [1, 2, 3]  # type: ignore[union-attr]
    feed.estimated(wanted, rough)
    feed.confirm(1)
    for _ in range(3):  # a page that goes on asking
        feed.want(wanted[:2])
        assert not feed.publish(wanted[:2], rough[:2])
        assert feed.take() is None
    assert feed.publish(wanted[:1], np.array([False]))
    assert feed.take().tolist() == [1]  # type: ignore[union-attr]
    feed.estimated(wanted[:1], np.array([False]))
    feed.confirm(2)
    feed.want(wanted[:1])  # the page gave it up since
    assert feed.publish(wanted[:1], np.array([True]))
    assert drain(feed) == [1]


def test_feed_forgets_what_an_old_light_wanted() -> None:
    feed = Feed()
    feed.reset(10)
    feed.want(np.arange(10, dtype=np.int32))
    feed.publish(np.arange(5, dtype=np.int32))
    feed.reset(4)
    assert not feed.publish(np.arange(5, 10, dtype=np.int32))
    assert drain(feed) == []


def test_parts_with_most_visible_particles_come_first() -> None:
    feed = PartFeed()
    feed.reset(95, 10)
    feed.want(np.array([94, 42, 41, 5, 43], np.int32))
    assert [feed.take() for _ in range(5)] == [4, 0, 9, 1, None]  # four messages at most are on their way
    feed.confirm(2)
    feed.want(np.array([71], np.int32))
    assert [feed.take() for _ in range(3)] == [7, 2, None]
    feed.confirm(99)  # no page can have more than it was sent
    assert [feed.take() for _ in range(4)] == [3, 5, 6, 8]
    feed.confirm(10)
    assert feed.take() is None


def test_parts_on_their_way_count_against_the_next_frame() -> None:
    feed = PartFeed()
    feed.reset(50, 10)
    assert [feed.take() for _ in range(3)] == [0, 1, 2]
    feed.reset(20, 10)
    assert [feed.take() for _ in range(2)] == [0, None]
    feed.confirm(1)
    assert [feed.take() for _ in range(2)] == [1, None]
    feed.reset()
    feed.want(np.array([3], np.int32))
    assert feed.take() is None


@pytest.mark.parametrize("count", [1, 2048, 10**6, 10**7])
@pytest.mark.parametrize("size", [1, 8, 17, 256, 4096])
def test_part_sizes_suit_the_pages_textures(count: int, size: int) -> None:
    part = part_size(count, size)
    assert part % 2048 == 0
    assert -(-count // part) <= 1024
    assert part == 2048 or part * size <= 1 << 20 or count > 2 * 10**6
