"""The one jit policy of all kernels, and a disk cache that notices edits in any of them.

Numba's own cache watches only the file of the jitted function: a kernel that inlines another from an edited file
would stay stale. So compiled code lives in a folder named after the sources of all kernels.
"""

from __future__ import annotations

import contextlib
import hashlib
import importlib
import os
import stat
import sys
import tempfile
from collections.abc import Callable
from pathlib import Path
from typing import Any, NoReturn

import numba
from numba.core.registry import CPUDispatcher
from numba.np import linalg

__all__ = ["cache_folder", "cold", "kernel", "warmed"]

# Results must not depend on how many particles share a call, so no `parallel`; threads come from the caller.
# NaN and infinity are kept meaningful: misses are marked by infinity. (Vector operations carry flags of their own.)
_FAST = {"nsz", "arcp", "contract", "afn", "reassoc"}


def _load_numba() -> None:
    """Load the rest of Numba without SciPy's BLAS, which takes as long as all else.

    Numba looks for it at once, only to say sooner that it is missing; it does so again for whoever's kernels multiply matrices. Ours do not.
    """
    look = linalg.ensure_blas
    linalg.ensure_blas = lambda: None
    try:
        importlib.import_module("numba.np.arraymath")
    finally:
        linalg.ensure_blas = look


_load_numba()


def _base_folder() -> Path:
    if chosen := os.environ.get("NUMBA_CACHE_DIR"):
        return Path(chosen)
    if sys.platform == "darwin":
        return Path.home() / "Library" / "Caches" / "luxel"
    if sys.platform == "win32":
        return Path(os.environ.get("LOCALAPPDATA", Path.home())) / "luxel" / "Cache"
    return Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache") / "luxel"


def _source_key() -> str:
    digest = hashlib.blake2b(numba.__version__.encode(), digest_size=8)
    for path in sorted(Path(__file__).parent.glob("*.py")):
        digest.update(path.read_bytes())
    return digest.hexdigest()


def _writable_folder() -> Path:
    name = f"kernels-{_source_key()}"
    try:
        folder = _base_folder() / name
        folder.mkdir(parents=True, exist_ok=True)
        if os.access(folder, os.W_OK):
            return folder
    except (OSError, RuntimeError):  # no home, read-only home
        pass
    return _private_temporary_folder() / name


def _private_temporary_folder() -> Path:
    """Return a folder that nobody else could have prepared: compiled code is loaded from it."""
    if hasattr(os, "getuid"):
        folder = Path(tempfile.gettempdir()) / f"luxel-{os.getuid()}"
        with contextlib.suppress(OSError):
            folder.mkdir(mode=0o700, exist_ok=True)
            found = folder.lstat()
            if stat.S_ISDIR(found.st_mode) and found.st_uid == os.getuid() and not found.st_mode & 0o077:
                return folder
    return Path(tempfile.mkdtemp(prefix="luxel-"))


cache_folder: Path = _writable_folder()
_cold = not any(cache_folder.rglob("*.nbc"))


def cold() -> bool:
    """Whether no kernel of this version had been compiled on this machine when the process started, nor ahead of use since."""
    return _cold


def warmed() -> None:
    """Note that kernels have been compiled ahead of use."""
    global _cold
    _cold = False


class _Inner(CPUDispatcher):
    """A kernel that only kernels call: it has no code that takes Python's objects apart, and calling that would end the process."""

    def __call__(self, *_: object, **__: object) -> NoReturn:
        msg = f"{self.py_func.__name__} is called by kernels only"
        raise TypeError(msg)


def kernel(
    function: Callable[..., Any] | None = None,
    *,
    inline: bool = False,
    borrows: bool = False,
    inner: bool = False,
) -> Any:
    """Compile a function with luxel's policy: nopython, no GIL, disk-cached, no exceptions for division by zero.

    Kernels take arrays and scalars, write results to arguments, allocate nothing in loops and never start threads.
    `inline` marks small functions that LLVM should always inline. `borrows` marks what neither allocates nor hands
    arrays to kernels that do: it goes without reference counts, which cost a call that passes a few dozen arrays
    more than the work of a short ray. `inner` marks what only other kernels call, as are all that are inlined and all private ones: a fifth
    of the time that compiling takes would go into code that converts their arguments.
    """

    def decorate(body: Callable[..., Any]) -> Any:
        nested = inner or inline or body.__name__.startswith("_")
        before = numba.config.CACHE_DIR
        numba.config.CACHE_DIR = str(cache_folder)
        try:
            made = numba.njit(
                nogil=True,
                cache=True,
                fastmath=_FAST,
                error_model="numpy",
                forceinline=inline,
                no_cfunc_wrapper=True,
                no_cpython_wrapper=nested,
                boundscheck=False,
                _nrt=not borrows,
            )(body)
        finally:
            numba.config.CACHE_DIR = before
        if nested:
            made.__class__ = _Inner
        return made

    return decorate if function is None else decorate(function)
