"""Our path tracing of every pixel against Mitsuba 3, an independent renderer, on one uniform-albedo scene."""

import numpy as np
import pytest

import luxel
from luxel.scene.colormap import linear_to_srgb, srgb_to_linear
from tests.scenes import cloud

ALBEDO = 0.6
SIZE = (96, 72)


@pytest.fixture(scope="module")
def mitsuba():
    module = pytest.importorskip("mitsuba")
    module.set_variant("scalar_rgb")
    return module


def mitsuba_radiance(mi, particles, camera, emitters, spp=144):
    data = np.concatenate([particles.positions, particles.radii[:, None]], axis=1)
    transform = mi.ScalarTransform4f().look_at(
        origin=list(camera.eye), target=list(camera.target), up=list(camera.up)
    )
    scene = {
        "type": "scene",
        "integrator": {"type": "path", "max_depth": -1},
        "sensor": {
            "type": "perspective",
            "fov": camera.fov,
            "fov_axis": "y",
            "to_world": transform,
            "film": {
                "type": "hdrfilm", "width": SIZE[0], "height": SIZE[1], "rfilter": {"type": "box"}, "pixel_format": "luminance",
            },
            "sampler": {"type": "independent", "sample_count": spp},
        },
        "spheres": {
            "type": "ellipsoids",
            "centers": mi.TensorXf(data[:, :3].astype(np.float32)),
            "scales": mi.TensorXf(np.repeat(data[:, 3:], 3, axis=1).astype(np.float32)),
            "quaternions": mi.TensorXf(np.tile(np.float32([0, 0, 0, 1]), (len(data), 1))),
            "extent": 1.0,
            "bsdf": {"type": "diffuse", "reflectance": {"type": "rgb", "value": ALBEDO}},
        },
        **emitters,
    }  # fmt: skip
    return np.array(mi.render(mi.load_dict(scene), spp=spp)).reshape(SIZE[1], SIZE[0])


@pytest.mark.parametrize("kind", ["sky", "sphere light"])
def test_pixels_equal_mitsuba(mitsuba, kind):
    particles = cloud(60, seed=4, radius=0.11)
    camera = luxel.Camera.framing(particles.bounds, aspect=SIZE[0] / SIZE[1])
    if kind == "sky":
        lights = (luxel.Sky(1.0),)
        emitters = {"sky": {"type": "constant", "radiance": {"type": "rgb", "value": 1.0}}}
    else:
        lights = (luxel.SphereLight((-3.0, -4.0, 5.0), 1.0, 10.0),)
        emitters = {
            "lamp": {
                "type": "sphere", "center": [-3.0, -4.0, 5.0], "radius": 1.0,
                "emitter": {"type": "area", "radiance": {"type": "rgb", "value": 10.0}},
            }
        }  # fmt: skip
    scene = luxel.Scene(particles, lights, albedo=ALBEDO)
    grey = "#{0:02x}{0:02x}{0:02x}".format(round(255 * float(linear_to_srgb(ALBEDO))))
    view = luxel.View(camera=camera, color=grey, background="black")
    from luxel.picture.raytrace import render

    image = render(scene, view, size=SIZE, light="pixel", samples=144, antialias=1)
    ours = image.array[..., 0]
    theirs = mitsuba_radiance(mitsuba, particles, camera, emitters)
    if kind != "sky":
        from luxel.light.lights import scene_white

        white = scene_white(scene)
        assert white <= 1, "dim enough for a linear tone curve"
    # Compare where the whole pixel lies on one sphere: neighbours have the same id.
    inner = np.zeros_like(image.ids, bool)
    core = image.ids[1:-1, 1:-1]
    inner[1:-1, 1:-1] = core >= 0
    for dy, dx in ((0, 1), (2, 1), (1, 0), (1, 2)):
        inner[1:-1, 1:-1] &= image.ids[dy : dy + core.shape[0], dx : dx + core.shape[1]] == core
    assert inner.sum() > 400
    ours_linear, theirs = srgb_to_linear(ours[inner] / 255.0), theirs[inner]
    difference = ours_linear - theirs
    assert abs(difference.mean()) < 0.004, difference.mean()
    assert np.sqrt((difference**2).mean()) < 0.045
    assert np.corrcoef(ours_linear, theirs)[0, 1] > 0.9
