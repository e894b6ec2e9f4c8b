"""Write docs/api.md from the docstrings of all that ``import luxel`` offers.

    python tools/make_api.py [--check]

Needs ``griffe2md`` (ISC licence), which the test extra brings.
"""

from __future__ import annotations

import argparse
import re
import sys
from pathlib import Path

from griffe import GriffeLoader, Parser
from griffe2md import ConfigDict, render_object_docs

import luxel

ROOT = Path(__file__).resolve().parent.parent
PAGE = ROOT / "docs" / "api.md"
HEAD = """# API

All of it is `luxel.NAME`. Made from the docstrings by `python tools/make_api.py`; change those, not this page.
The method, its units and its conventions: [`light.md`](light.md), [`conventions.md`](conventions.md).
"""
# What one does first stands first; the rest follows by name.
FIRST = ("open", "Scene", "View", "render", "view", "bake", "bake_to", "encode_to", "open_baked", "export")
STYLE: ConfigDict = {
    "docstring_style": "numpy",
    "docstring_section_style": "list",
    "filters": ["!^_"],
    "heading_level": 2,
    "line_length": 110,
    "show_if_no_docstring": False,
    "show_root_heading": True,
    "show_signature_annotations": True,
    "signature_crossrefs": False,
    "summary": False,
}


def page() -> str:
    """Return the page as text."""
    loader = GriffeLoader(search_paths=[ROOT / "src"], docstring_parser=Parser.numpy)
    loader.load("luxel")
    loader.resolve_aliases(implicit=True)
    names = [*FIRST, *(name for name in luxel._HOMES if name not in FIRST)]
    parts = [HEAD]
    for name in names:
        home = luxel._HOMES[name]
        found = loader.modules_collection[f"{home}.{name}"]
        made = render_object_docs(found.final_target if found.is_alias else found, STYLE)
        parts.append(f"## `luxel.{name}`\n\n{_plain(made, name)}\n")
    return "\n".join(parts)


def _plain(text: str, name: str) -> str:
    """Leave out links to what is not on the page, and roles and paths that readers of Markdown have no use for."""
    text = re.sub(r"\[([^\[\]]*)\]\(#[^)]*\)", lambda found: found[1].replace("\\", ""), text)
    text = re.sub(r"</?code>", "`", text)
    text = re.sub(r":\w+:`~?(?:luxel\.(?:\w+\.)*)?(\w+(?:\.\w+)?)`", r"`\1`", text)
    text = re.sub(r"^(#+) `(?:\w+\.)*?(\w+\.\w+)`$", r"\1 `\2`", text, flags=re.M)
    text = re.sub(r" – $", "", text, flags=re.M)
    text = re.sub(r"(?<!`)``(?!`)", "`", text)
    text = re.sub(r"^(```python\n)\w+\(", rf"\1{name}(", text, count=1, flags=re.M)
    return text.split("\n", 1)[1].strip()


def main() -> None:
    """Write the page, or say whether it is what the docstrings say."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument(
        "--check", action="store_true", help="change nothing; fail if the page is out of date"
    )
    text = page()
    if not parser.parse_args().check:
        PAGE.write_text(text, encoding="utf-8")
    elif PAGE.read_text(encoding="utf-8") != text:
        sys.exit(f"{PAGE}: out of date — run python tools/make_api.py")


if __name__ == "__main__":
    main()
