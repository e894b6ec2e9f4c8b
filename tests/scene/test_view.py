import json
import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from luxel import Camera, Particles, View
from luxel.errors import InputError, ScalarError
from luxel.scene.colormap import colormap_table, srgb_to_linear
from luxel.scene.view import lut_rows


def particles(**scalars):
    count = len(next(iter(scalars.values()))) if scalars else 3
    points = np.arange(3 * count, dtype=np.float64).reshape(count, 3)
    return Particles(points, 0.5, scalars)


def test_default_view_needs_no_matplotlib_and_is_uniform():
    colors = View().colors(particles())
    assert colors.shape == (3, 3)
    assert colors.dtype == np.float32
    np.testing.assert_allclose(colors[0], srgb_to_linear(np.array([0xD9, 0xD5, 0xCC]) / 255), rtol=1e-6)
    assert View().normalised(particles()).tolist() == [0, 0, 0]


def test_colors_are_rows_of_the_map_in_linear_light():
    data = particles(t=np.linspace(0, 1, 257))
    table = colormap_table("magma")
    rows = np.minimum(255, np.floor(np.linspace(0, 1, 257) * 256).astype(int))
    expected = srgb_to_linear(table[rows] / 255)
    np.testing.assert_allclose(View(color_by="t", colormap="magma").colors(data), expected, atol=1e-6)


def test_nan_has_its_own_color():
    data = particles(t=[0.0, np.nan, 1.0])
    colors = View(color_by="t", nan_color="#ff0000").colors(data)
    assert colors[1].tolist() == [1, 0, 0]
    assert colors[0].tolist() != [1, 0, 0]


def test_infinite_values_are_the_ends():
    view = View(color_by="t")
    data = particles(t=[-np.inf, 1.0, 2.0, np.inf])
    assert view.scalar_range(data) == (1.0, 2.0)
    assert view.normalised(data).tolist() == [0, 0, 1, 1]


def test_range_clips():
    view = View(color_by="t", range=(1, 3))
    assert view.normalised(particles(t=[0.0, 1.0, 2.0, 3.0, 9.0])).tolist() == [0, 0, 0.5, 1, 1]


def test_log():
    data = particles(t=[1.0, 10.0, 100.0, 0.0, -5.0, np.nan])
    view = View(color_by="t", log=True)
    assert view.scalar_range(data) == (1.0, 100.0)
    np.testing.assert_allclose(view.normalised(data), [0, 0.5, 1, 0, 0, np.nan], atol=1e-7)


@pytest.mark.parametrize("log", [False, True])
@pytest.mark.parametrize(
    "values", [[5.0, 5.0], [0.0, 0.0], [-2.0, -2.0], [np.nan, np.nan], [np.inf, np.nan], [7, 7]]
)
def test_degenerate_scalars(values, log):
    view = View(color_by="t", log=log)
    data = particles(t=values)
    low, high = view.scalar_range(data)
    assert low < high
    assert math.isfinite(low)
    assert math.isfinite(high)
    assert not log or low > 0
    found = view.normalised(data)
    assert np.array_equal(np.isnan(found), np.isnan(np.asarray(values, float)))
    assert view.colors(data).shape == (2, 3)


@settings(deadline=None, derandomize=True)
@given(
    st.lists(st.floats(width=64, allow_nan=True, allow_infinity=True), min_size=1, max_size=8),
    st.booleans(),
)
def test_normalised_is_in_range_monotonous_and_nan_only_without_data(values, log):
    data = particles(t=np.array(values))
    view = View(color_by="t", log=log)
    found = view.normalised(data)
    assert np.array_equal(np.isnan(found), np.isnan(values))
    good = ~np.isnan(values)
    assert ((found[good] >= 0) & (found[good] <= 1)).all()
    assert (np.diff(found[good][np.argsort(np.array(values)[good])]) >= 0).all()


@pytest.mark.parametrize("dtype", [np.uint8, np.int8, np.int64, np.float32, np.float16, np.uint64])
def test_all_dtypes(dtype):
    data = particles(t=np.array([0, 1, 100], dtype=dtype))
    np.testing.assert_allclose(View(color_by="t").normalised(data), [0, 0.01, 1], atol=1e-6)


def test_blocks_agree_with_one_pass(monkeypatch):
    data = particles(t=np.random.default_rng(1).random(100))
    whole = View(color_by="t").normalised(data)
    monkeypatch.setattr("luxel.scene.view._BLOCK", 7)
    assert np.array_equal(View(color_by="t").normalised(data), whole)


def test_vector_magnitude_and_component():
    data = particles(v=np.array([[3.0, 4.0, 0.0], [0.0, 0.0, 0.0]]))
    assert View(color_by="v").scalar_range(data) == (0.0, 5.0)
    assert View(color_by="v.y").scalar_range(data) == (0.0, 4.0)


def test_unknown_scalar_lists_those_there_are():
    with pytest.raises(ScalarError, match="stress"):
        View(color_by="strain").colors(particles(stress=[1.0, 2.0]))


# Categories


def test_integer_codes_under_a_qualitative_map():
    data = particles(kind=np.array([0, 3, 9, 10, -1]))
    view = View(color_by="kind", colormap="tab10")
    assert view.categorical(data)
    assert lut_rows(view.normalised(data), 10).tolist() == [0, 3, 9, 0, 9]
    np.testing.assert_allclose(
        view.colors(data)[1], srgb_to_linear(colormap_table("tab10")[3] / 255), atol=1e-6
    )


def test_every_code_of_every_qualitative_map_finds_its_row():
    for name in ("tab10", "tab20", "Set1", "Set3", "Accent"):
        n = len(colormap_table(name))
        view = View(color_by="kind", colormap=name)
        assert lut_rows(view.normalised(particles(kind=np.arange(n))), n).tolist() == list(range(n))


def test_labelled_codes_spread_over_a_continuous_map():
    data = Particles(
        np.eye(3), 1, {"element": np.array([0, 1, 2], np.uint8)}, categories={"element": ("H", "C", "O")}
    )
    view = View(color_by="element")
    assert view.categorical(data)
    np.testing.assert_allclose(view.normalised(data), [1 / 6, 3 / 6, 5 / 6], atol=1e-6)


def test_small_integer_types_do_not_overflow():
    labels = tuple(f"label {k}" for k in range(300))
    data = Particles(np.eye(3), 1, {"e": np.array([0, 100, 255], np.uint8)}, categories={"e": labels})
    np.testing.assert_allclose(
        View(color_by="e").normalised(data), (np.array([0, 100, 255]) + 0.5) / 300, atol=1e-6
    )


def test_integers_under_a_continuous_map_are_a_scale():
    data = particles(count=np.array([0, 5, 10]))
    assert not View(color_by="count").categorical(data)
    assert View(color_by="count").normalised(data).tolist() == [0, 0.5, 1]


def test_a_range_makes_codes_a_scale():
    data = particles(kind=np.array([0, 5, 10]))
    view = View(color_by="kind", colormap="tab10", range=(0, 10))
    assert not view.categorical(data)
    assert view.normalised(data).tolist() == [0, 0.5, 1]


def test_missing_codes_are_no_data():
    data = Particles(np.eye(3), 1, {"e": np.array([0.0, np.nan, 1.0])}, categories={"e": ("a", "b")})
    assert np.isnan(View(color_by="e").normalised(data)).tolist() == [False, True, False]


def test_lut_rows():
    x = np.array([0, 0.25, 0.999, 1.0, np.nan], np.float32)
    assert lut_rows(x, 4).tolist() == [0, 1, 3, 3, 4]


# Cameras


def test_camera_for_frames_the_data():
    data = particles()
    square = View().camera_for(data, (100, 100))
    wide = View().camera_for(data, (1600, 900))
    assert isinstance(square, Camera)
    np.testing.assert_allclose(square.target, data.bounds.mean(axis=0))
    np.testing.assert_allclose(View().camera_for(data, 16 / 9).eye, wide.eye)
    assert np.linalg.norm(np.subtract(square.eye, square.target)) >= np.linalg.norm(
        np.subtract(wide.eye, wide.target)
    )


def test_camera_for_keeps_a_given_camera():
    camera = Camera((5, 0, 0), (0, 0, 0))
    assert View(camera=camera).camera_for(particles(), (10, 10)) is camera


def test_up_axis():
    assert View(up="y").camera_for(particles()).up.tolist() == [0, 1, 0]


# Validation and JSON


@pytest.mark.parametrize(
    "fields, message",
    [
        ({"colormap": "viridi"}, "viridis"),
        ({"colormap": 3}, "colormap"),
        ({"range": (2, 1)}, "lo < hi"),
        ({"range": (1, 1)}, "lo < hi"),
        ({"range": (0, np.nan)}, "finite"),
        ({"range": (0, 1, 2)}, "two finite"),
        ({"range": "ab"}, "two finite"),
        ({"range": 5}, "two finite"),
        ({"range": (0, 1), "log": True}, "positive"),
        ({"log": "yes"}, "log"),
        ({"exposure": 0}, "exposure"),
        ({"exposure": -1}, "exposure"),
        ({"exposure": math.nan}, "exposure"),
        ({"exposure": "bright"}, "exposure"),
        ({"background": "whyte"}, "background"),
        ({"color": "nope"}, "color"),
        ({"nan_color": "nope"}, "nan_color"),
        ({"up": "w"}, "up"),
        ({"up": ["z"]}, "up"),
        ({"color_by": ""}, "color_by"),
        ({"color_by": 3}, "color_by"),
        ({"camera": (1, 2, 3)}, "camera"),
    ],
)
def test_bad_fields_are_refused(fields, message):
    with pytest.raises(InputError, match=message):
        View(**fields)


VIEWS = [
    View(),
    View(
        color_by="stress", colormap="tab10", range=(1, 2.5), log=True, exposure=2, background="white", up="y"
    ),
    View(camera=Camera((1, 2, 3), (0, 0, 0), fov=40), nan_color="red", color="0.3"),
    View(camera=Camera((1, 2, 3), (0, 0, 0), up=(0, 1, 0), height=2.5)),
]


@pytest.mark.parametrize("view", VIEWS)
def test_json_round_trip(view):
    data = json.loads(json.dumps(view.to_json(), allow_nan=False))
    again = View.from_json(data)
    assert again.to_json() == view.to_json()
    np.testing.assert_array_equal(
        view.camera_for(particles(), (4, 3)).basis(), again.camera_for(particles(), (4, 3)).basis()
    )


def test_json_may_leave_fields_out():
    assert View.from_json({"color_by": "stress"}).to_json() == View(color_by="stress").to_json()


@pytest.mark.parametrize(
    "data, message",
    [
        ({"colour": "red"}, "colour.*known are"),
        ({"camera": {"eye": [1, 2, 3]}}, "target"),
        ({"camera": {"eye": [1, 2, 3], "target": [0, 0, 0], "zoom": 2}}, "zoom"),
        ({"camera": {"eye": "abc", "target": [0, 0, 0]}}, "camera eye"),
        ({"camera": {"eye": [1, 2, 3], "target": [0, 0, 0], "fov": "wide"}}, "fov"),
        ({"camera": {"eye": [1, 2], "target": [0, 0, 0]}}, "camera eye"),
        ({"camera": [1, 2]}, "JSON object"),
        ([1], "JSON object"),
        (None, "JSON object"),
    ],
)
def test_bad_json_is_refused(data, message):
    with pytest.raises(InputError, match=message):
        View.from_json(data)


def test_with_changes_validates():
    assert View().with_changes(color_by="t").color_by == "t"
    with pytest.raises(InputError):
        View().with_changes(exposure=-1)
