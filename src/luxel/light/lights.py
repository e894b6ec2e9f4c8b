"""Lights as kernels take them, and the bounds that follow from them."""

from __future__ import annotations

import math

import numpy as np

from luxel.kernels.light import Lights
from luxel.scene.lights import QuadLight, Sky, SphereLight, Sun
from luxel.scene.scene import Scene
from luxel.trace.spheres import SphereSet

__all__ = ["luminance_scale", "pack_lights", "scene_white"]


def pack_lights(scene: Scene, spheres: SphereSet) -> Lights:
    """Return the scene's lights as float32 arrays in normalised units (see :class:`luxel.kernels.light.Lights`)."""
    sky = np.zeros(5, np.float32)
    suns, globes, quads = [], [], []
    for light in scene.effective_lights:
        match light:
            case Sky():
                ground = light.level if light.ground is None else light.ground
                sky[:] = (light.level, ground, *np.asarray(light.axis))
            case Sun():
                half = math.radians(light.angular_diameter) / 2
                suns.append((*np.asarray(light.direction), light.level, math.sin(half), math.cos(half)))
            case SphereLight():
                globes.append(
                    (*spheres.to_unit(light.center), spheres.length_to_unit(light.radius), light.level)
                )
            case QuadLight():
                edges = np.asarray([light.edge_u, light.edge_v]) / spheres.unit
                normal = np.cross(edges[0], edges[1])
                area = float(np.linalg.norm(normal))
                quads.append(
                    (
                        *spheres.to_unit(light.corner),
                        *edges[0],
                        *edges[1],
                        *(normal / area),
                        area,
                        light.level,
                    )
                )
    return Lights(
        sky,
        np.array(suns, np.float32).reshape(-1, 6),
        np.array(globes, np.float32).reshape(-1, 5),
        np.array(quads, np.float32).reshape(-1, 14),
    )


def scene_white(scene: Scene) -> float:
    """Luminance that displays as white: what all lights together add to a surface that faces every one of them."""
    sky, direct = _levels(scene)
    return max(sky + direct, 1e-6)


def luminance_scale(scene: Scene) -> float:
    """Luminance of code 255, known before any texel is baked.

    Direct light is at most the sum of all levels. Bounces of sky light never exceed the sky (the furnace bound);
    those of other lights add a share of the albedo. Deep bright hollows can exceed it: such texels clip and are counted.
    """
    sky, direct = _levels(scene)
    bounce = scene.albedo if scene.model == "interreflection" else 0.0
    return max(sky + direct / (1.0 - 0.25 * bounce), 1e-6)


def _levels(scene: Scene) -> tuple[float, float]:
    sky, direct = 0.0, 0.0
    lights = scene.effective_lights
    if any(
        isinstance(light, SphereLight | QuadLight) for light in lights
    ):  # bounds take a pass over all particles
        low, high = scene.particles.bounds
    for light in lights:
        match light:
            case Sky():
                sky = max(light.level, light.level if light.ground is None else light.ground)
            case Sun():
                direct += light.level
            case SphereLight():
                center = np.asarray(light.center)
                gap = float(np.linalg.norm(center - np.clip(center, low, high)))
                direct += light.level * min(1.0, (light.radius / gap) ** 2 if gap > light.radius else 1.0)
            case QuadLight():
                edge_u, edge_v = np.asarray(light.edge_u), np.asarray(light.edge_v)
                middle = np.asarray(light.corner) + 0.5 * (edge_u + edge_v)
                reach = 0.5 * float(np.linalg.norm(edge_u) + np.linalg.norm(edge_v))
                gap = float(np.linalg.norm(middle - np.clip(middle, low, high))) - reach
                area = float(np.linalg.norm(np.cross(edge_u, edge_v)))
                direct += light.level * min(1.0, area / (math.pi * gap * gap) if gap > 0 else 1.0)
    return sky, direct
