import numpy as np
import pytest
from matplotlib import colormaps

from luxel.errors import InputError
from luxel.scene.colormap import (
    colormap_names,
    colormap_table,
    hex_color,
    linear_to_srgb,
    rgb,
    srgb_to_linear,
)


def test_srgb_known_values():
    # From the standard: mid grey 0.5 is 0.2140 of linear light; the curve's foot is a line of slope 1/12.92.
    np.testing.assert_allclose(
        srgb_to_linear([0.0, 0.04, 0.5, 1.0]), [0, 0.04 / 12.92, 0.21404114, 1], rtol=1e-7
    )


def test_srgb_pieces_meet():
    gap = srgb_to_linear(np.array([0.04045 - 1e-12, 0.04045 + 1e-12]))
    assert abs(gap[1] - gap[0]) < 1e-7


def test_srgb_inverse():
    values = np.linspace(0, 1, 1001)
    np.testing.assert_allclose(linear_to_srgb(srgb_to_linear(values)), values, atol=1e-7)
    codes = np.arange(256)
    assert np.array_equal(
        np.round(linear_to_srgb(srgb_to_linear((codes / 255).astype(np.float32))) * 255), codes
    )


@pytest.mark.parametrize(
    "dtype, expected", [(np.float32, np.float32), (np.float64, np.float64), (np.int64, np.float64)]
)
def test_srgb_keeps_single_precision(dtype, expected):
    assert srgb_to_linear(np.ones(3, dtype)).dtype == expected
    assert linear_to_srgb(np.ones(3, dtype)).dtype == expected


@pytest.mark.parametrize(
    "given, expected",
    [
        ("white", "#ffffff"),
        ("#d9d5cc", "#d9d5cc"),
        ("0.2", "#333333"),
        ("C0", "#1f77b4"),
        ((1, 0, 0), "#ff0000"),
        ("#F00", "#ff0000"),
    ],
)
def test_hex_color(given, expected):
    assert hex_color(given) == expected


@pytest.mark.parametrize("given", ["whyte", "", None, 7, "none", (1, 0, 0, 0.5), [], "#12345"])
def test_bad_colors_are_refused(given):
    with pytest.raises(InputError, match="background"):
        hex_color(given, "background")


def test_bad_color_names_the_nearest():
    with pytest.raises(InputError, match="white"):
        hex_color("whyte")


def test_rgb():
    assert rgb("#ff8000").tolist() == [1.0, 128 / 255, 0.0]


def test_continuous_table_is_matplotlibs():
    expected = colormaps["magma"](np.arange(256))[:, :3] * 255
    assert np.abs(colormap_table("magma") - expected).max() <= 0.5


@pytest.mark.parametrize(
    "name, rows",
    [("tab10", 10), ("Set1", 9), ("tab20", 20), ("viridis", 256), ("twilight", 256), ("coolwarm", 256)],
)
def test_table_rows(name, rows):
    table = colormap_table(name)
    assert table.shape == (rows, 3)
    assert table.dtype == np.uint8


def test_table_cannot_be_changed():
    with pytest.raises(ValueError):
        colormap_table("viridis")[0] = 0


def test_twilight_ends_meet():
    table = colormap_table("twilight").astype(int)
    assert np.abs(table[0] - table[-1]).max() <= 2


@pytest.mark.parametrize("given, near", [("Viridis", "viridis"), ("rdbu", "RdBu"), ("plasm", "plasma")])
def test_unknown_colormap_names_the_nearest(given, near):
    with pytest.raises(InputError, match=near):
        colormap_table(given)


def test_names_start_with_the_shortlist_and_have_no_duplicates():
    names = colormap_names()
    assert names[:6] == ["viridis", "inferno", "magma", "plasma", "cividis", "turbo"]
    assert len(names) == len(set(names)) > 80
    assert {name for name in names if name.endswith("_r")} == {"RdBu_r", "Spectral_r"}
    assert {"tab10", "gray", "coolwarm"} <= set(names)
