"""Files that are either there and complete or not there at all, whatever ends the process; and who may write them."""

from __future__ import annotations

import contextlib
import errno
import logging
import os
import shutil
import sys
from collections.abc import Iterator
from pathlib import Path

from luxel.errors import StorageError

__all__ = ["DRAFT_SUFFIX", "LOCK_NAME", "lock", "remove_drafts", "remove_tree", "write_file"]

log = logging.getLogger(__name__)

DRAFT_SUFFIX = ".part"
LOCK_NAME = ".luxel.lock"

_FULL = {errno.ENOSPC, errno.EDQUOT}
_NO_LOCKS = {errno.ENOLCK, errno.ENOSYS, errno.EOPNOTSUPP, errno.EINVAL}


def write_file(path: Path, content: bytes) -> None:
    """Write a whole file; a crash, a kill or a power cut leaves the old one, or none, but never half of one.

    Raises
    ------
    StorageError
        For a full disk or a place that cannot be written.
    """
    draft = path.with_name(path.name + DRAFT_SUFFIX)
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        with open(draft, "wb") as file:
            file.write(content)
            file.flush()
            os.fsync(file.fileno())
        os.replace(draft, path)
        _sync_folder(path.parent)
    except OSError as error:
        with contextlib.suppress(OSError):
            draft.unlink()
        raise _refused(path, error) from error
    except BaseException:  # Ctrl-C
        with contextlib.suppress(OSError):
            draft.unlink()
        raise


def remove_drafts(folder: Path) -> None:
    """Remove what an earlier process that was killed had begun to write."""
    for draft in folder.rglob(f"*{DRAFT_SUFFIX}"):
        with contextlib.suppress(OSError):
            draft.unlink()


def remove_tree(path: Path) -> None:
    """Remove a file, or a folder and all in it, if it is there."""
    try:
        if path.is_dir() and not path.is_symlink():
            shutil.rmtree(path)
        else:
            path.unlink(missing_ok=True)
    except OSError as error:
        raise _refused(path, error) from error


@contextlib.contextmanager
def lock(folder: Path) -> Iterator[None]:
    """Keep other processes from writing to `folder`, which is made if it is not there.

    The operating system ends the lock with the process, so that one that was killed never blocks the next.

    Raises
    ------
    StorageError
        If another process holds it.
    """
    path = folder / LOCK_NAME
    try:
        folder.mkdir(parents=True, exist_ok=True)
        descriptor = _acquire(path)
    except OSError as error:
        raise _refused(path, error) from error
    if descriptor is None:
        raise StorageError(
            f"{folder}: another process is baking into this store — wait for it, or give another -o"
        )
    try:
        yield
    finally:
        # Removed while it is held, so that a store does not tell how often it was worked on.
        with contextlib.suppress(OSError):
            path.unlink()
        os.close(descriptor)


def _acquire(path: Path) -> int | None:
    while True:
        descriptor = os.open(path, os.O_RDWR | os.O_CREAT, 0o666)
        try:
            _lock_file(descriptor)
        except BlockingIOError:
            os.close(descriptor)
            return None
        except OSError as error:
            if error.errno not in _NO_LOCKS:
                os.close(descriptor)
                raise
            log.warning("%s: this file system has no locks; do not bake into it twice at once", path.parent)
        # Whoever held it before has removed the file: then this lock is on nothing.
        with contextlib.suppress(FileNotFoundError):
            if os.path.samestat(os.fstat(descriptor), os.stat(path)):
                return descriptor
        os.close(descriptor)


if sys.platform == "win32":
    import msvcrt

    def _lock_file(descriptor: int) -> None:
        try:
            msvcrt.locking(descriptor, msvcrt.LK_NBLCK, 1)
        except PermissionError as error:
            raise BlockingIOError(error.errno, error.strerror) from error

    def _sync_folder(folder: Path) -> None:
        """Windows writes names through by itself."""

else:
    import fcntl

    def _lock_file(descriptor: int) -> None:
        fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)

    def _sync_folder(folder: Path) -> None:
        descriptor = os.open(folder, os.O_RDONLY)
        try:
            os.fsync(descriptor)
        finally:
            os.close(descriptor)


def _refused(path: Path, error: OSError) -> StorageError:
    reason = error.strerror or str(error)
    if error.errno in _FULL:
        return StorageError(
            f"{path}: the disk is full ({reason}); what was finished before is kept"
            " — free some space and run the same command again"
        )
    return StorageError(f"{path}: cannot write it ({reason}) — check the permissions, or give another -o")
