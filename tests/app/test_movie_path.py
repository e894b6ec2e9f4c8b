"""Where the camera of a movie goes."""

from __future__ import annotations

import itertools
import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from luxel import Camera, Cut, Select, View
from luxel.app.movie_path import interpolated, orbit_angles, orbited, steps_between, steps_shown
from luxel.errors import InputError


def key(
    azimuth: float,
    elevation: float = 20.0,
    distance: float = 4.0,
    target: tuple[float, float, float] = (0, 0, 0),
    **changes: object,
) -> View:
    a, e = math.radians(azimuth), math.radians(elevation)
    away = np.array([math.cos(e) * math.cos(a), math.cos(e) * math.sin(a), math.sin(e)])
    return View(camera=Camera(np.asarray(target) + distance * away, target)).with_changes(**changes)


def away(view: View) -> np.ndarray:
    assert view.camera is not None
    return np.asarray(view.camera.eye) - np.asarray(view.camera.target)


def test_the_path_goes_through_its_keys() -> None:
    keys = [key(0), key(40, 50, 2.0), key(90, -10, 8.0), key(100, 0, 1.0, (1, 2, 3))]
    found = interpolated(keys, 31)
    assert len(found) == 31
    for view, k in zip(keys, (0, 10, 20, 30), strict=True):
        assert found[k] is view
    assert interpolated([keys[0]], 3) == [keys[0]] * 3
    assert interpolated(keys, 1) == [keys[0]]


@settings(max_examples=40, deadline=None)
@given(
    st.lists(st.tuples(st.floats(-720, 720), st.floats(-89, 89), st.floats(0.1, 100)), min_size=2, max_size=5)
)
def test_the_horizon_stays_level_and_nothing_overshoots(numbers: list[tuple[float, float, float]]) -> None:
    keys = [key(*each) for each in numbers]
    count = 8 * (len(keys) - 1) + 1
    found = interpolated(keys, count)
    distances = np.array([np.linalg.norm(away(view)) for view in found])
    heights = np.array([away(view)[2] for view in found]) / distances
    for view in found:
        assert view.camera is not None
        right = view.camera.basis()[0]
        assert abs(right[2]) < 1e-6
    for values in (distances, heights):
        for k in range(len(keys) - 1):
            part = values[8 * k : 8 * k + 9]
            low, high = sorted((part[0], part[-1]))
            assert low - 1e-9 <= part.min()
            assert part.max() <= high * (1 + 1e-9) + 1e-9


def test_azimuth_takes_the_short_way_and_distance_equal_factors() -> None:
    middle = interpolated([key(170, 0, 1.0), key(190, 0, 16.0)], 3)[1]
    np.testing.assert_allclose(away(middle), [-4.0, 0.0, 0.0], atol=1e-9)


def test_looking_straight_down_has_the_azimuth_of_its_neighbours() -> None:
    found = interpolated([key(30, 0), key(0, 90), key(30, 0)], 9)
    for view in found[1:4] + found[5:8]:
        x, y, _ = away(view)
        assert math.degrees(math.atan2(y, x)) == pytest.approx(30)


def test_the_path_is_smooth() -> None:
    keys = [key(0), key(30, 40, 3.0), key(80, 10, 5.0), key(120, 30, 2.0)]
    eyes = np.array([np.asarray(view.camera.eye) for view in interpolated(keys, 3001)])  # type: ignore[union-attr]
    speed = np.diff(eyes, axis=0)
    assert np.abs(np.diff(speed, axis=0)).max() < 0.01 * np.abs(speed).max()  # no jerk at the keys


def test_cameras_with_other_ups_turn_freely() -> None:
    keys = [key(0), View(camera=Camera((0, -3, 0), (0, 0, 0), up=(1, 0, 0)))]
    found = interpolated(keys, 7)
    for before, after in itertools.pairwise(found):
        assert before.camera is not None
        assert after.camera is not None
        assert (before.camera.basis() * after.camera.basis()).sum(1).min() > 0.8
    assert found[0] is keys[0]


def test_numbers_move_and_the_rest_changes_at_the_keys() -> None:
    hides = [(Cut("x", 0.0), Select("T", 1.0, None)), (Cut("x", 4.0), Select("T", 3.0, None))]
    first = key(0, exposure=1.0, range=(0.0, 1.0), color_by="T", hide=hides[0], background="#000000")
    last = key(90, exposure=4.0, range=(2.0, 5.0), color_by="T", hide=hides[1], background="#ffffff")
    middle = interpolated([first, last], 5)[2]
    assert middle.exposure == pytest.approx(2.0)
    assert middle.range == pytest.approx((1.0, 3.0))
    assert middle.conditions == (Cut("x", 2.0), Select("T", 2.0, None))
    assert middle.background == "#000000"
    log = [view.with_changes(log=True, range=ends) for view, ends in ((first, (1, 10)), (last, (100, 1000)))]
    assert interpolated(log, 3)[1].range == pytest.approx((10.0, 100.0))
    other = last.with_changes(color_by="p", hide=(Cut("y", 4.0),))
    middle = interpolated([first, other], 3)[1]
    assert (middle.range, middle.conditions) == (first.range, first.conditions)


def test_orthographic_heights_move_too_and_kinds_do_not_mix() -> None:
    keys = [View(camera=Camera((0, -3, 0), (0, 0, 0), height=height)) for height in (1.0, 4.0)]
    middle = interpolated(keys, 3)[1]
    assert middle.camera is not None
    assert middle.camera.height == pytest.approx(2.0)
    with pytest.raises(InputError, match="orthographic"):
        interpolated([keys[0], key(0)], 3)


@pytest.mark.parametrize("up", ["x", "y", "z"])
def test_orbits_turn_about_up(up: str) -> None:
    axis = np.eye(3)["xyz".index(up)]
    view = View(camera=Camera((1.0, 2.0, 3.0), (0.5, 0.0, 0.0), up=axis))
    quarter = orbited(view, 90)
    assert quarter.camera is not None
    assert quarter.camera.fov == 30.0
    np.testing.assert_array_equal(quarter.camera.target, view.camera.target)  # type: ignore[union-attr]
    before, after = away(view), away(quarter)
    assert after @ axis == pytest.approx(before @ axis)
    flat = [each - axis * (each @ axis) for each in (before, after)]
    assert flat[0] @ flat[1] == pytest.approx(0.0, abs=1e-9)
    np.testing.assert_allclose(np.cross(*flat), axis * (flat[0] @ flat[0]), atol=1e-9)
    np.testing.assert_allclose(away(orbited(view, 360)), before, atol=1e-9)


def test_whole_turns_loop_and_others_arrive() -> None:
    assert orbit_angles(360, 4) == [0, 90, 180, 270]
    assert orbit_angles(-720, 4) == [0, -180, -360, -540]
    assert orbit_angles(90, 4) == [0, 30, 60, 90]
    assert orbit_angles(90, 1) == [0]


def test_time_steps_are_spread_evenly() -> None:
    assert steps_shown([3, 5], 2) == [3, 5]
    assert steps_shown([3, 5, 7], 6) == [3, 3, 5, 5, 7, 7]
    assert steps_shown(list(range(10)), 5) == [0, 2, 4, 6, 8]
    assert steps_between([0, 4, 0], 9) == [0, 1, 2, 3, 4, 3, 2, 1, 0]
