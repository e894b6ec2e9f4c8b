"""What a codec is: 8-bit textures in, records of a fixed number of bytes out, and back."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from luxel.errors import InputError

__all__ = ["Codec", "Codes", "Progress", "as_codes", "as_payload", "gathered", "parts", "shared_array"]

#: (N, T, T) uint8; anything that slices to arrays will do, such as a memory map.
Codes = Any
Progress = Callable[[int, int], None]

#: Textures that are worked on at a time.
BLOCK = 4096


class Codec(Protocol):
    """How textures are stored (paper 3.3). Frozen; encoding a texture does not depend on those beside it.

    Attributes
    ----------
    kind
        Its name in files: ``"raw"``, ``"vq"``, ``"pca"``, ``"cpca"`` or ``"sh"``.
    texels
        Rows and columns of a texture.
    """

    @property
    def kind(self) -> str:
        """Name, see `KINDS`."""
        ...

    @property
    def texels(self) -> int:
        """Rows and columns of a texture."""
        ...

    @property
    def payload_bytes(self) -> int:
        """Bytes a texture."""
        ...

    @property
    def shared(self) -> dict[str, NDArray[Any]]:
        """Arrays stored once: codebook, basis, and so on."""
        ...

    @property
    def shared_bytes(self) -> int:
        """Bytes of all of `shared`."""
        ...

    def describe(self) -> dict[str, Any]:
        """Settings fit for JSON; with `shared`, all that :func:`luxel.textures.codecs.restore` needs."""
        ...

    def encode(self, codes: Codes) -> NDArray[np.uint8]:
        """Turn (K, T, T) codes into records (K, `payload_bytes`)."""
        ...

    def decode(self, payload: NDArray[np.uint8]) -> NDArray[np.uint8]:
        """Turn records (K, `payload_bytes`) into codes (K, T, T)."""
        ...

    def lookup(self, payload: NDArray[np.uint8]) -> Any:
        """Return what kernels read texels of these records from, see ``kernels.lookup``."""
        ...


def parts(count: int, size: int = BLOCK) -> list[slice]:
    """Slices of at most `size` that cover `count` textures."""
    return [slice(k, min(k + size, count)) for k in range(0, count, size)]


def as_codes(codes: Codes, texels: int | None = None) -> Any:
    """Check that `codes` are (K, T, T) uint8 and return them.

    Raises
    ------
    InputError
        For another shape or dtype, or if T is not `texels`.
    """
    shape, dtype = getattr(codes, "shape", None), getattr(codes, "dtype", None)
    if shape is None or len(shape) != 3 or shape[1] != shape[2] or dtype != np.uint8:
        raise InputError(
            f"codes must be an array (K, texels, texels) of uint8, got shape {shape}, dtype {dtype}"
        )
    if texels is not None and shape[1] != texels:
        raise InputError(
            f"this codec is for textures of {texels} x {texels} texels, got {shape[1]} x {shape[2]}"
        )
    return codes


def as_payload(payload: NDArray[np.uint8], size: int) -> NDArray[np.uint8]:
    """Check that `payload` is (K, size) uint8 and return it contiguous.

    Raises
    ------
    InputError
        For another shape or dtype.
    """
    payload = np.asarray(payload)
    if payload.ndim != 2 or payload.shape[1] != size or payload.dtype != np.uint8:
        raise InputError(
            f"payload must be records (K, {size}) of uint8 for this codec, got shape {payload.shape}, dtype {payload.dtype}"
        )
    return np.ascontiguousarray(payload)


def gathered(codes: Codes | Iterable[NDArray[np.uint8]]) -> Any:
    """Return `codes` as one array: as they are, or concatenated if they come as an iterable of blocks."""
    if hasattr(codes, "shape"):
        return as_codes(codes)
    blocks = list(codes)
    if not blocks:
        raise InputError("codes must hold at least one texture, got no blocks")
    return as_codes(np.concatenate(blocks))


def blocks_of(codes: Codes | Iterable[NDArray[np.uint8]]) -> Iterator[NDArray[np.uint8]]:
    """Yield `codes` in blocks, whether they are an array or come as an iterable of blocks."""
    if hasattr(codes, "shape"):
        array: Any = as_codes(codes)
        for part in parts(len(array)):
            yield np.asarray(array[part])
    else:
        yield from codes


def shared_array(
    shared: dict[str, NDArray[Any]], name: str, dtype: Any, shape: tuple[int | None, ...]
) -> NDArray[Any]:
    """Return the named array of `shared`, checked.

    Parameters
    ----------
    shape
        None stands for any length of at least 1.

    Raises
    ------
    InputError
        If it is missing or of another dtype or shape.
    """
    if name not in shared:
        raise InputError(f"the codec's array {name!r} is missing; found {sorted(shared) or 'none'}")
    array = np.asarray(shared[name])
    fits = array.ndim == len(shape) and all(
        n >= 1 and (want is None or n == want) for n, want in zip(array.shape, shape, strict=True)
    )
    if array.dtype != dtype or not fits:
        wanted = ", ".join("any" if n is None else str(n) for n in shape)
        raise InputError(
            f"the codec's array {name!r} must be {np.dtype(dtype)} of shape ({wanted}), "
            f"got {array.dtype} of shape {array.shape}; the file is damaged or of another version"
        )
    return np.ascontiguousarray(array)


def shared_size(shared: dict[str, NDArray[Any]]) -> int:
    """Bytes of all arrays."""
    return sum(int(array.nbytes) for array in shared.values())


def setting(description: dict[str, Any], name: str, low: int, high: int) -> int:
    """Return a whole number of `description` within low..high.

    Raises
    ------
    InputError
        If it is missing, no whole number, or out of range.
    """
    value = description.get(name)
    if not isinstance(value, int) or isinstance(value, bool) or not low <= value <= high:
        raise InputError(
            f"the codec's {name} must be a whole number in {low}..{high}, got {value!r}; the file is damaged"
        )
    return value


def one_target(**targets: Any) -> tuple[str, Any]:
    """Return the one target of training that is given.

    Raises
    ------
    InputError
        If there is none, or more than one, or it is not positive.
    """
    given = [(name, value) for name, value in targets.items() if value is not None]
    if len(given) != 1:
        raise InputError(f"give exactly one of {', '.join(targets)}, got {len(given)}")
    name, value = given[0]
    if not value > 0:
        raise InputError(f"{name} must be positive, got {value}")
    return name, value
