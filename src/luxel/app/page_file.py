"""A page that is a file: the client, its style and all data in one HTML document that asks nobody for anything."""

from __future__ import annotations

import base64
import contextlib
import hashlib
import html
import os
import struct
import zlib
from collections.abc import Iterable, Iterator
from pathlib import Path

from luxel.app.bundle import CLIENT_FOLDER, client_module, markup, stylesheet
from luxel.errors import MissingFileError, StorageError

__all__ = ["check_page_path", "page_overhead", "write_page"]

_LEVEL = 9
_ENTRY = "file"  # the client's module that such a page runs


def check_page_path(path: str | os.PathLike[str]) -> Path:
    """Return where a page is to be written, before anything is computed for it.

    Raises
    ------
    MissingFileError
        If there is no such directory.
    StorageError
        If the place is a directory.
    """
    target = Path(path)
    if not target.parent.is_dir():
        raise MissingFileError(f"{target}: no such directory — make it first")
    if target.is_dir():
        raise StorageError(f"{target}: is a directory — give a file such as {target / 'page.html'}")
    return target


def page_overhead() -> int:
    """Bytes of a page without data."""
    return len("".join(_frame("")).encode())


def write_page(
    path: str | os.PathLike[str], title: str, head: Iterable[bytes], blocks: Iterable[bytes]
) -> int:
    """Write a page and return its bytes. A file that is there already is replaced only once the new one is complete.

    Parameters
    ----------
    path
        See :func:`check_page_path`.
    title
        Of the document.
    head
        What the page needs first: a JSON description, then messages, see ``client/file.js``.
    blocks
        Parts of the data, each packed by itself.

    Raises
    ------
    StorageError
        If it cannot be written; nothing is left behind then, nor after an interruption.
    """
    target = check_page_path(path)
    before, after = _frame(title)
    draft = target.with_name(f".{target.name}.{os.getpid()}.part")
    try:
        with draft.open("wb") as file:
            file.write(before.encode())
            file.writelines(_data("head", b"".join(struct.pack("<I", len(part)) + part for part in head)))
            for block in blocks:
                file.writelines(_data("block", block))
            file.write(after.encode())
        size = draft.stat().st_size
        os.replace(draft, target)
    except OSError as error:
        raise StorageError(f"{target}: cannot write it ({error.strerror or error})") from error
    finally:
        with contextlib.suppress(OSError):
            draft.unlink()
    return size


def _data(kind: str, data: bytes) -> Iterator[bytes]:
    packer = zlib.compressobj(_LEVEL, zlib.DEFLATED, -zlib.MAX_WBITS)
    yield f'<script type="text/plain" data-luxel="{kind}">'.encode()
    yield base64.b64encode(packer.compress(data) + packer.flush())
    yield b"</script>\n"


def _frame(title: str) -> tuple[str, str]:
    """Return what comes before the data and what after it."""
    style = stylesheet()
    script = client_module(_ENTRY).replace("</script", "<\\/script").replace("<!--", "<\\!--")
    icon = base64.b64encode((CLIENT_FOLDER / "icon.svg").read_bytes()).decode()
    policy = (
        f"default-src 'none'; script-src {_source(script)}; style-src {_source(style)}; img-src data: blob:; "
        "base-uri 'none'; form-action 'none'"
    )
    before = f"""<!doctype html>
<html lang="en">
<head>
<meta charset="utf-8">
<meta http-equiv="Content-Security-Policy" content="{policy}">
<meta name="viewport" content="width=device-width, initial-scale=1">
<meta name="generator" content="luxel">
<title>{html.escape(title)} – luxel</title>
<link rel="icon" href="data:image/svg+xml;base64,{icon}">
<style>{style}</style>
</head>
<body class="luxel">{markup()}<noscript>This page draws with JavaScript, which is switched off here.</noscript>
"""
    return before, f'<script type="module">{script}</script>\n</body>\n</html>\n'


def _source(text: str) -> str:
    """Return what allows exactly this text in a content security policy."""
    return f"'sha256-{base64.b64encode(hashlib.sha256(text.encode()).digest()).decode()}'"
