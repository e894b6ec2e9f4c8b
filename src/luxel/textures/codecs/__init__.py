"""Codecs of luminance textures (paper 3.3): how a bake is stored in fewer bytes.

>>> codec = train("cpca", bake.codes, ratio=16)
>>> payload = codec.encode(bake.codes)
>>> same = restore(codec.describe(), codec.shared)
"""

from __future__ import annotations

import inspect
from collections.abc import Callable
from typing import Any

from numpy.typing import NDArray

from luxel.errors import InputError
from luxel.textures.codecs.clustered import ClusteredPCACodec
from luxel.textures.codecs.distortion import Distortion
from luxel.textures.codecs.linear import PCACodec, SHCodec
from luxel.textures.codecs.moments import IncrementalPCA
from luxel.textures.codecs.protocol import Codec, Codes, Progress, gathered
from luxel.textures.codecs.raw import RawCodec
from luxel.textures.codecs.vq import VQCodec

__all__ = [
    "KINDS",
    "ClusteredPCACodec",
    "Codec",
    "Distortion",
    "IncrementalPCA",
    "PCACodec",
    "RawCodec",
    "SHCodec",
    "VQCodec",
    "restore",
    "train",
]

_CLASSES: dict[str, Any] = {
    each.kind: each for each in (RawCodec, VQCodec, PCACodec, ClusteredPCACodec, SHCodec)
}

#: Names of all codecs.
KINDS = tuple(_CLASSES)


def train(
    kind: str, codes: Codes, *, seed: int = 0, progress: Progress | None = None, **targets: Any
) -> Codec:
    """Make a codec for a set of textures.

    Parameters
    ----------
    kind
        ``"raw"``, ``"vq"``, ``"pca"``, ``"cpca"`` (clustered PCA: the least error at equal bytes) or ``"sh"``.
    codes
        (N, T, T) uint8, a memory map of it, or an iterable of blocks.
    seed
        Of what is drawn at random in training.
    progress
        Called as ``progress(done, total)``.
    **targets
        One of ``ratio`` (raw bytes over all bytes stored; all kinds), ``error`` (root mean squared, in codes; not
        ``"sh"``), or the kind's own: ``codewords``, ``components``, ``payload_bytes``, ``degree``. ``"cpca"`` also takes
        ``clusters``, ``"sh"`` ``mapping``, ``"vq"`` ``exact``. Those that are None count as not given.

    Raises
    ------
    InputError
        For an unknown kind or target, or a target that cannot be reached.
    """
    chosen = _class(kind)
    given = {name: value for name, value in targets.items() if value is not None}
    allowed: Callable[..., Any] | None = getattr(chosen, "train", None)
    if allowed is None:
        return RawCodec(int(gathered(codes).shape[1]))
    names = inspect.signature(allowed).parameters
    for name in given:
        if name not in names:
            raise InputError(f"{kind} codecs are not trained to {name!r}")
    if "seed" in names:
        given["seed"] = seed
    made: Codec = allowed(codes, progress=progress, **given)
    return made


def restore(description: dict[str, Any], shared: dict[str, NDArray[Any]]) -> Codec:
    """Rebuild a codec from its :meth:`~Codec.describe` and :attr:`~Codec.shared`, checking both.

    Raises
    ------
    InputError
        If something is missing, of a wrong type or shape, or contradicts the rest.
    """
    if not isinstance(description, dict):
        raise InputError(f"a codec's description must be a dictionary, got {type(description).__name__}")
    made: Codec = _class(description.get("kind")).restore(description, shared)
    return made


def _class(kind: Any) -> Any:
    if not isinstance(kind, str) or kind not in _CLASSES:
        raise InputError(f"codec must be one of {', '.join(KINDS)}, got {kind!r}")
    return _CLASSES[kind]
