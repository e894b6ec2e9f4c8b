"""The client in one piece, for where its modules cannot be fetched one by one: notebooks and exported pages.

Every module becomes a function that returns what it exports, called in the order of imports. That is all that bundling takes here,
because the modules import only each other, by relative name, and export only declarations. Comments, indentation and line ends that mean nothing are left
out, which makes it a quarter smaller.
"""

from __future__ import annotations

import re
from functools import lru_cache
from pathlib import Path

__all__ = ["CLIENT_FOLDER", "client_module", "markup", "stylesheet"]

CLIENT_FOLDER = Path(__file__).parent / "client"

_IMPORT = re.compile(r'^import\s+([^;"]+?)\s+from\s+"\./([\w-]+)\.js";$', re.MULTILINE)
_EXPORT = re.compile(r"^export (?:(?:async )?function\*?|class|const) +(?=([\w$]+))", re.MULTILINE)
_EXPORT_LIST = re.compile(r"^export \{ ?([\w$]+(?:, [\w$]+)*) ?\};$", re.MULTILINE)
_STATEMENT = re.compile(r"^(?:import|export)\b.*$", re.MULTILINE)
_COMMENT = re.compile(r"^[ \t]*(?://.*|/\*\*(?:(?!\*/)[\s\S])*\*/[ \t]*)\n|/\*\* .*?\*/ ?", re.MULTILINE)
_REMARK = re.compile(
    r"[ \t]+// .*$", re.MULTILINE
)  # behind code: no text of the client holds two slashes between spaces
_LINE_END = re.compile(r"(?<=[;{,(])\n(?!#)")  # shaders have lines that begin with a number sign, and mean it
# Nothing depends on indentation: the only texts of several lines are those of shaders.
_INDENT = re.compile(r"^\s+", re.MULTILINE)


@lru_cache
def client_module(entry: str) -> str:
    """Return one JavaScript module that does what the client's module `entry` does, and exports what it exports.

    Parameters
    ----------
    entry
        Its name without ``.js``.

    Raises
    ------
    ValueError
        For an import or export that is more than what this module says above.
    """
    parts: list[str] = []
    exported = _add(entry, parts, {}, ())
    names = f"export const {{ {', '.join(exported)} }} = {_name(entry)};\n" if exported else ""
    return _LINE_END.sub("", "".join(parts)) + names


@lru_cache
def markup() -> str:
    """Return the inside of the page's body."""
    page = (CLIENT_FOLDER / "index.html").read_text(encoding="utf-8")
    return _INDENT.sub("", page[page.index(">", page.index("<body")) + 1 : page.index("</body>")])


@lru_cache
def stylesheet() -> str:
    """Return the page's style, which applies inside elements of class ``luxel`` only."""
    return (CLIENT_FOLDER / "style.css").read_text(encoding="utf-8")


def _add(module: str, parts: list[str], done: dict[str, list[str]], path: tuple[str, ...]) -> list[str]:
    """Append a module's code behind that of all it imports; return the names it exports."""
    if module in path:
        raise ValueError(f"client modules import each other in a circle: {' -> '.join([*path, module])}")
    if module in done:
        return done[module]
    text = (CLIENT_FOLDER / f"{module}.js").read_text(encoding="utf-8")
    source = _INDENT.sub("", _REMARK.sub("", _COMMENT.sub("", text)))
    for imported in _IMPORT.finditer(source):
        there = _add(imported[2], parts, done, (*path, module))
        wanted = re.findall(r"([\w$]+)(?:\s+as\s+[\w$]+)?", imported[1]) if imported[1][0] == "{" else []
        if missing := [name for name in wanted if name not in there]:
            raise ValueError(
                f"client module {module}.js imports {', '.join(missing)}, which {imported[2]}.js does not export"
            )
    source = _IMPORT.sub(lambda found: f"const {_bindings(found[1])} = {_name(found[2])};", source)
    exported = [found[1] for found in _EXPORT.finditer(source)]
    for found in _EXPORT_LIST.finditer(source):
        exported += found[1].split(", ")
    source = _EXPORT_LIST.sub("", source)
    source = _EXPORT.sub(lambda found: found[0].removeprefix("export "), source)
    if left := _STATEMENT.search(source):
        raise ValueError(f"client module {module}.js: cannot bundle {left[0]!r}")
    parts.append(
        f"const {_name(module)} = (() => {{\n{source}\nreturn {{ {', '.join(exported)} }};\n}})();\n"
    )
    done[module] = exported
    return exported


def _name(module: str) -> str:
    return f"${module.replace('-', '_')}"


def _bindings(clause: str) -> str:
    """Turn ``{ a, b as c }`` into the pattern ``{ a, b: c }``, and ``* as a`` into ``a``."""
    whole = re.fullmatch(r"\*\s+as\s+([\w$]+)", clause)
    if whole:
        return whole[1]
    if not (clause.startswith("{") and clause.endswith("}")):
        raise ValueError(f"cannot bundle an import of {clause!r}")
    return re.sub(r"\s+as\s+", ": ", clause)
