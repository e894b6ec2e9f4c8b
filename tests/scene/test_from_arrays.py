"""Plain arrays in place of particles: what they become, and what is refused."""

import numpy as np
import pytest

import luxel
from luxel.errors import InputError
from luxel.scene.colormap import srgb_to_linear
from luxel.scene.from_arrays import from_arrays, is_array, looked_at

POSITIONS = np.random.default_rng(0).random((5, 3))
COLORS = np.random.default_rng(1).random((5, 3))


@pytest.mark.parametrize(
    "colors", [COLORS, COLORS.astype(np.float32), np.round(255 * COLORS).astype(np.int64)]
)
def test_colors_are_shown_as_they_are(colors):
    particles, view = from_arrays(POSITIONS, radii=0.1, colors=colors)
    srgb = colors / 255 if colors.dtype.kind == "i" else colors
    np.testing.assert_allclose(view.colors(particles), srgb_to_linear(srgb), atol=1e-6)
    assert luxel.View.from_json(view.to_json()).colormap == view.colormap


def test_values_are_shown_in_the_colour_map():
    values = np.arange(5.0)
    particles, view = from_arrays(POSITIONS, luxel.View(colormap="magma"), color_by=values)
    expected = luxel.View(color_by="v", colormap="magma").colors(luxel.Particles(POSITIONS, 1, {"v": values}))
    np.testing.assert_array_equal(view.colors(particles), expected)


def test_named_scalars_and_columns_keep_their_names():
    particles, view = from_arrays(POSITIONS, scalars={"stress": np.arange(5)}, color_by="stress")
    assert (particles.names(), view.color_by) == (["stress"], "stress")

    class Column(np.ndarray):
        name = "heat"

    particles, view = from_arrays(POSITIONS, color_by=np.arange(5).view(Column))
    assert (particles.names(), view.color_by) == (["heat"], "heat")


@pytest.mark.parametrize("color", ["tomato", (255, 99, 71), np.array([255, 99, 71]) / 255])
def test_one_color_for_all(color):
    assert from_arrays(POSITIONS, colors=color)[1].color == "#ff6347"


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"colors": COLORS[:4]}, r"colors must have shape \(5, 3\), got \(4, 3\)"),
        ({"colors": np.ones((5, 4))}, "leave the alpha channel out"),
        ({"colors": np.ones(5)}, "color_by"),
        ({"colors": 2 * COLORS}, r"0\.\.1, as floating point numbers do"),
        ({"colors": np.full((5, 3), 256)}, r"0\.\.255, as whole numbers do; they do not in 5 of 5"),
        ({"colors": np.full((5, 3), np.nan)}, "they do not in 5 of 5"),
        ({"colors": "nocolour"}, "nocolour"),
        ({"color_by": np.ones(4)}, r"color_by must have shape \(5,\)"),
        ({"color_by": 3.0}, "color_by must have shape"),
        ({"color_by": "heat"}, "no scalar 'heat'"),
        ({"color_by": np.ones(5), "colors": COLORS}, "one of them"),
        ({"radii": np.ones(4)}, r"radii must be one number or have shape \(5,\)"),
    ],
)
def test_what_does_not_fit_is_refused(options, message):
    with pytest.raises(InputError, match=message):
        from_arrays(POSITIONS, **options)


@pytest.mark.parametrize("positions", [np.zeros((2, 5, 3)), np.zeros(3), [[0, 0]], [["a", "b", "c"]]])
def test_positions_must_be_points(positions):
    with pytest.raises(InputError, match="positions"):
        from_arrays(positions)


def test_arrays_are_told_from_what_holds_particles():
    particles = luxel.Particles(POSITIONS, 0.1)
    assert is_array(POSITIONS)
    assert is_array(POSITIONS.tolist())
    assert not any(
        is_array(each) for each in (particles, [particles], luxel.Scene(particles), "file", ["a", "b"])
    )


def test_particles_bring_their_own():
    particles = luxel.Particles(POSITIONS, 0.1, {"heat": np.arange(5)})
    assert looked_at(particles, None, color_by="heat")[1].color_by == "heat"
    with pytest.raises(InputError, match="radii: for arrays of positions only; a Particles brings its own"):
        looked_at(particles, None, radii=1.0)
    with pytest.raises(InputError, match="name of a scalar"):
        looked_at(particles, None, color_by=np.arange(5))


def test_render_takes_arrays_and_keeps_the_hue():
    """Light makes a colour darker or brighter, never another: the ratios of linear channels are those given."""
    colors = np.tile([0.8, 0.4, 0.1], (5, 1))
    image = luxel.render(POSITIONS, size=(64, 48), radii=0.2, colors=colors, samples=1)
    linear = srgb_to_linear(image.pixels[image.ids >= 0] / 255.0)
    bright = linear[linear[:, 0] > 0.2]  # eight bits say little about dark ones
    assert len(bright) > 50
    given = srgb_to_linear(np.array([0.8, 0.4, 0.1]))
    np.testing.assert_allclose(bright[:, 1] / bright[:, 0], given[1] / given[0], rtol=0.08)
    scene = luxel.Scene(luxel.Particles(POSITIONS, 0.2))
    same = luxel.render(scene, luxel.View(color="#cc661a"), size=(64, 48), samples=1)
    np.testing.assert_array_equal(image.ids, same.ids)
    assert np.abs(image.pixels.astype(int) - same.pixels.astype(int)).max() <= 1
