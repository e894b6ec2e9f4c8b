"""The one place that wires particle data, scene, textures and engine; what the front ends share."""

from luxel.session.session import Session
from luxel.session.status import Status
from luxel.session.textures import SessionTextures

__all__ = ["Session", "SessionTextures", "Status"]
