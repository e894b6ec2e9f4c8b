"""Cameras: where a picture is taken from."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from luxel.arrays import as_vector
from luxel.errors import InputError
from luxel.scene.lights import Up, up_frame

__all__ = ["Camera"]


@dataclass(frozen=True, eq=False)
class Camera:
    """A perspective or orthographic camera.

    Parameters
    ----------
    eye, target
        Where the camera is and what it looks at, in file units.
    up
        Roughly upwards in the picture; need not be perpendicular to the view.
    fov
        Vertical field of view in degrees, for perspective.
    height
        Vertical extent of the picture in file units, for an orthographic camera; None means perspective.
    """

    eye: ArrayLike
    target: ArrayLike
    up: ArrayLike = (0.0, 0.0, 1.0)
    fov: float = 30.0
    height: float | None = None

    def __post_init__(self) -> None:
        for name in ("eye", "target"):
            object.__setattr__(self, name, as_vector(getattr(self, name), f"camera {name}"))
        object.__setattr__(self, "up", as_vector(self.up, "camera up", unit=True))
        if not 0.0 < self.fov < 180.0:
            raise InputError(f"camera fov must be in (0, 180) degrees, got {self.fov}")
        if self.height is not None and not (math.isfinite(self.height) and self.height > 0):
            raise InputError(f"camera height must be positive, got {self.height}")
        if not np.linalg.norm(np.asarray(self.target) - np.asarray(self.eye)) > 0:
            raise InputError("camera eye and target must differ")

    @property
    def orthographic(self) -> bool:
        """Whether parallel lines stay parallel."""
        return self.height is not None

    def basis(self) -> NDArray[np.float64]:
        """Return (3, 3) unit rows: right, up, forward."""
        forward = np.asarray(self.target, dtype=np.float64) - np.asarray(self.eye, dtype=np.float64)
        forward /= np.linalg.norm(forward)
        up = np.asarray(self.up, dtype=np.float64)
        right = _cross(forward, up)
        if np.linalg.norm(right) < 1e-6:  # looking straight along `up`
            right = _cross(forward, np.eye(3)[np.abs(up).argmin()])
        right /= np.linalg.norm(right)
        return np.stack([right, _cross(right, forward), forward])

    @classmethod
    def framing(
        cls,
        bounds: NDArray[np.floating[Any]],
        *,
        up: Up = "z",
        azimuth: float = -60.0,
        elevation: float = 25.0,
        fov: float = 30.0,
        aspect: float = 16 / 9,
        orthographic: bool = False,
    ) -> Camera:
        """Return a camera that sees all of `bounds` (2, 3), from `azimuth` and `elevation` in degrees.

        `aspect` is width over height of the picture it should fit.
        """
        low, high = np.asarray(bounds, dtype=np.float64)
        target = 0.5 * (low + high)
        frame = up_frame(up)
        a, e = math.radians(azimuth), math.radians(elevation)
        towards = np.array([math.cos(e) * math.cos(a), math.cos(e) * math.sin(a), math.sin(e)]) @ frame
        size = float(np.linalg.norm(high - low)) or 1.0
        probe = cls(target + towards * size, target, up=frame[2], fov=fov)
        right, upward, forward = probe.basis()
        corners = np.array(
            [[x, y, z] for x in (low[0], high[0]) for y in (low[1], high[1]) for z in (low[2], high[2])]
        )
        offset = corners - target
        across, along, depth = offset @ right, offset @ upward, offset @ forward
        margin = 1.06
        if orthographic:
            height = 2 * margin * max(float(np.abs(along).max()), float(np.abs(across).max()) / aspect) or 1.0
            return cls(target + towards * 2 * size, target, up=frame[2], fov=fov, height=height)
        slope = math.tan(math.radians(fov) / 2) / margin
        distance = max(
            float((np.abs(along) / slope - depth).max()),
            float((np.abs(across) / (slope * aspect) - depth).max()),
        )
        return cls(target + towards * max(distance, 1e-3 * size), target, up=frame[2], fov=fov)


def _cross(a: NDArray[np.float64], b: NDArray[np.float64]) -> NDArray[np.float64]:
    """As np.cross of two vectors, in a tenth of the time: it is asked for every frame."""
    (ax, ay, az), (bx, by, bz) = a.tolist(), b.tolist()
    return np.array([ay * bz - az * by, az * bx - ax * bz, ax * by - ay * bx])
