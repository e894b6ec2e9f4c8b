import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from luxel import Particles, View
from luxel.errors import ScalarError
from luxel.picture.colorbar import draw_colorbar
from luxel.picture.ticks import tick_labels
from luxel.scene.colormap import colormap_table

DARK, LIGHT = (23, 25, 29), (250, 250, 250)


def canvas(height=360, width=640, color=DARK, channels=3):
    pixels = np.empty((height, width, channels), np.uint8)
    pixels[:] = (*color, 255)[:channels]
    return pixels


def particles(values, **more):
    values = np.asarray(values)
    return Particles(np.arange(3.0 * len(values)).reshape(-1, 3), 0.5, {"stress": values}, **more)


def touched(before, after):
    """Columns and rows that changed."""
    changed = (before != after).any(axis=2)
    return np.flatnonzero(changed.any(axis=0)), np.flatnonzero(changed.any(axis=1))


def has_color(pixels, color, tolerance=3):
    return bool((np.abs(pixels[..., :3].astype(int) - np.asarray(color)).max(axis=2) <= tolerance).any())


RAMP = particles(np.linspace(0, 1, 50))


@pytest.mark.parametrize("size", [(240, 320), (360, 640), (720, 1280), (1080, 1920), (600, 400)])
def test_bar_stands_at_the_right_and_scales(size):
    before = canvas(*size)
    columns, rows = touched(before, draw_colorbar(before, View(color_by="stress"), RAMP))
    assert columns[0] > 0.7 * size[1]
    assert columns[-1] < size[1]
    assert 0.4 * size[0] < np.ptp(rows) < 0.75 * size[0]
    assert abs(rows.mean() - size[0] / 2) < 0.06 * size[0]


@pytest.mark.parametrize("name", ["viridis", "magma", "tab10"])
def test_bar_shows_the_map_with_its_high_end_on_top(name):
    data = particles(np.linspace(0.0, 1.0, 50))
    drawn = draw_colorbar(canvas(720, 1280), View(color_by="stress", colormap=name), data)
    table = colormap_table(name)
    rows = [np.flatnonzero((drawn == table[k]).all(axis=2).any(axis=1)) for k in (1, len(table) - 2)]
    assert rows[1].mean() < rows[0].mean()
    shown = {tuple(color) for color in drawn.reshape(-1, 3)}
    assert np.mean([tuple(color) in shown for color in table]) > 0.95


def test_input_is_not_changed():
    before = canvas()
    kept = before.copy()
    draw_colorbar(before, View(color_by="stress"), RAMP)
    assert np.array_equal(before, kept)


@pytest.mark.parametrize("background, ink", [(DARK, 240), (LIGHT, 24)])
def test_ink_stands_out(background, ink):
    drawn = draw_colorbar(canvas(color=background), View(color_by="stress", colormap="gray"), RAMP)
    title = drawn[60:110, 480:].astype(int)
    assert np.abs(title - ink).min() <= 6
    assert np.abs(title - background[0]).max() > 150


@pytest.mark.parametrize("size", [(99, 640), (360, 139), (1, 1)])
def test_small_pictures_stay(size):
    before = canvas(*size)
    assert np.array_equal(draw_colorbar(before, View(color_by="stress"), RAMP), before)


def test_uniform_color_needs_no_bar():
    before = canvas()
    assert np.array_equal(draw_colorbar(before, View(), RAMP), before)


def test_transparent_pictures_stay_transparent_elsewhere():
    before = canvas(channels=4)
    before[..., 3] = 0
    drawn = draw_colorbar(before, View(color_by="stress"), RAMP)
    assert drawn.shape == before.shape
    assert (drawn[:, :200, 3] == 0).all()
    assert (drawn[..., 3] == 255).any()


def test_no_data_has_a_disc_only_where_there_is_nan():
    view = View(color_by="stress", nan_color="#ff00ff")
    assert has_color(draw_colorbar(canvas(), view, particles([0.0, np.nan, 1.0])), (255, 0, 255))
    assert not has_color(draw_colorbar(canvas(), view, RAMP), (255, 0, 255))


def test_all_nan():
    view = View(color_by="stress", nan_color="#ff00ff")
    assert has_color(draw_colorbar(canvas(), view, particles([np.nan, np.nan])), (255, 0, 255))


def test_arrow_where_data_lie_beyond_the_range():
    def height(low, high):
        view = View(color_by="stress", range=(low, high))
        return np.ptp(touched(canvas(720, 1280), draw_colorbar(canvas(720, 1280), view, RAMP))[1])

    assert height(-0.1, 1.1) < height(-0.1, 0.9) < height(0.1, 0.9)


def test_categories_show_the_colors_that_occur():
    data = particles(np.array([0, 2, 2], np.uint8), categories={"stress": ("H", "He", "Li")})
    drawn = draw_colorbar(canvas(720, 1280), View(color_by="stress", colormap="tab10"), data)
    table = colormap_table("tab10")
    assert [has_color(drawn, table[k], 1) for k in (0, 1, 2, 3)] == [True, False, True, False]


def test_many_categories_fit_the_picture():
    data = particles(np.arange(500))
    before = canvas()
    rows = touched(before, draw_colorbar(before, View(color_by="stress", colormap="tab20"), data))[1]
    assert rows[0] >= 0
    assert rows[-1] < 359


def test_long_names_do_not_cover_the_picture():
    name = "a_very_long_name_" * 20
    data = Particles(np.eye(3), 1, {name: [1.0, 2.0, 3.0]})
    before = canvas()
    assert touched(before, draw_colorbar(before, View(color_by=name), data))[0][0] > 0.45 * 640


def test_unknown_scalar():
    with pytest.raises(ScalarError):
        draw_colorbar(canvas(), View(color_by="nope"), RAMP)


# Ticks


@pytest.mark.parametrize(
    "low, high, labels, factor",
    [
        (0, 1, ["0.0", "0.2", "0.4", "0.6", "0.8", "1.0"], ""),
        (-30e6, 50e6, ["−2", "0", "2", "4"], "×10⁷"),
        (1e-5, 3e-5, ["1.0", "1.5", "2.0", "2.5", "3.0"], "×10⁻⁵"),
        (0, 1.3, ["0.00", "0.25", "0.50", "0.75", "1.00", "1.25"], ""),
        (0, 90e3, ["0", "20000", "40000", "60000", "80000"], ""),
    ],
)
def test_linear_ticks(low, high, labels, factor):
    ticks, common = tick_labels(low, high)
    assert [label for _, label in ticks] == labels
    assert common == factor


@pytest.mark.parametrize(
    "low, high, labels",
    [
        (1, 1000, ["1", "10", "100", "1000"]),
        (0.2, 2, ["0.2", "0.5", "1", "2"]),
        (1e-7, 1e2, ["10⁻⁷", "10⁻⁵", "10⁻³", "10⁻¹", "10¹"]),
        (2, 3, ["2.0", "2.2", "2.4", "2.6", "2.8", "3.0"]),
    ],
)
def test_log_ticks(low, high, labels):
    assert [label for _, label in tick_labels(low, high, log=True)[0]] == labels


def test_places_match_labels():
    for place, label in tick_labels(2, 30)[0]:
        assert place == pytest.approx((float(label) - 2) / 28)
    for place, label in tick_labels(2, 3000, log=True)[0]:
        assert place == pytest.approx(math.log(float(label) / 2) / math.log(1500))


@settings(deadline=None, derandomize=True, max_examples=300)
@given(
    st.floats(allow_nan=False, allow_infinity=False),
    st.floats(allow_nan=False, allow_infinity=False),
    st.booleans(),
)
def test_any_range_has_ticks_inside_it(a, b, log):
    view = View(color_by="stress", log=log)
    low, high = view.scalar_range(particles([a, b]))
    ticks, _ = tick_labels(low, high, log=log)
    assert all(-1e-6 <= place <= 1 + 1e-6 for place, _ in ticks)
    assert len(ticks) <= 12
