"""TextureSpec: how textures are sampled and stored. With the scene's key it makes the light key."""

from __future__ import annotations

import hashlib
import math
from dataclasses import dataclass
from typing import Any, Literal, get_args

from luxel.errors import InputError
from luxel.light.mapping import Mapping, mapping_code
from luxel.scene.scene import Scene

__all__ = ["DEFAULT_SAMPLES", "Mode", "Purpose", "TextureSpec", "light_key"]

Mode = Literal["paper", "fast"]


#: What textures are made for: to be kept, to be looked at while they are refined, or for one picture, of which only what it shows is sampled.
Purpose = Literal["bake", "view", "picture"]

# Samples a texel where nobody says how many: a fast one errs as much as 49 raw ones, in pictures by 3 levels of 255, six in view
# and nine of all texels by less than 2 (`python -m benchmarks.light`).
DEFAULT_SAMPLES: dict[Mode, dict[Purpose, int]] = {
    "fast": {"bake": 1, "view": 9, "picture": 6},
    "paper": {"bake": 49, "view": 49, "picture": 49},
}


@dataclass(frozen=True)
class TextureSpec:
    """How luminance textures are made (paper 3.2).

    Parameters
    ----------
    texels
        Rows and columns.
    samples
        Jittered samples a texel; a square number in ``paper`` mode. In ``fast`` mode, small texels near the poles of a latitude-longitude map have fewer.
    mode
        ``"paper"``: Monte Carlo path tracing to the letter, linear codes. ``"fast"``: the same paths, then a filter
        in texture space whose covariance is learned from the data set, and square-root codes.
    seed
        Of the counter-based random numbers.
    max_bounces
        Interreflection stops after so many bounces; None means never (unbiased roulette decides).
    mapping
        From texels to directions: ``"latlong"``, latitude-longitude as in the paper, or ``"octahedral"``, whose texels
        all have the same solid angle (Clarberg 2008).

    Raises
    ------
    InputError
        For values out of range; a sample count that is no square names the nearest two.
    """

    texels: int = 16
    samples: int = 49
    mode: Mode = "paper"
    seed: int = 0
    max_bounces: int | None = None
    mapping: Mapping = "latlong"

    def __post_init__(self) -> None:
        if not (isinstance(self.texels, int) and 4 <= self.texels <= 64 and self.texels % 2 == 0):
            raise InputError(f"texels must be an even number in 4..64, got {self.texels}")
        if self.mode not in get_args(Mode):
            raise InputError(f"mode must be paper or fast, got {self.mode!r}")
        root = math.isqrt(self.samples) if isinstance(self.samples, int) and self.samples > 0 else 0
        if root == 0 or (root * root != self.samples and self.mode == "paper"):
            kind = "square number (n x n jittered)" if self.mode == "paper" else "whole number"
            near = f"; the nearest squares are {root * root or 1} and {(root + 1) ** 2}" if root else ""
            raise InputError(f"samples must be a positive {kind}, got {self.samples}{near}")
        if not isinstance(self.seed, int) or not 0 <= self.seed < 2**63:
            raise InputError(f"seed must be a whole number >= 0, got {self.seed!r}")
        if self.max_bounces is not None and self.max_bounces < 0:
            raise InputError(f"max_bounces must be >= 0, got {self.max_bounces}")
        mapping_code(self.mapping)

    @classmethod
    def usual(
        cls, mode: Mode = "fast", samples: int | None = None, *, purpose: Purpose = "bake", **others: Any
    ) -> TextureSpec:
        """Return a spec with the usual number of samples of its mode and purpose, where None are given."""
        if samples is None:
            samples = DEFAULT_SAMPLES[mode][purpose] if mode in DEFAULT_SAMPLES else 1  # refused in one place
        return cls(mode=mode, samples=samples, **others)

    @property
    def encoding(self) -> Literal["linear", "sqrt"]:
        """How luminance becomes 8 bits: the paper's linear codes, else square roots (no bands in the dark)."""
        return "linear" if self.mode == "paper" else "sqrt"


def light_key(scene: Scene, spec: TextureSpec) -> str:
    """Hex digest that names every texture of this scene and spec; camera and colours never change it."""
    return hashlib.blake2b(f"{scene.key} {spec}".encode(), digest_size=16).hexdigest()
