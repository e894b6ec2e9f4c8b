"""The client in one piece does what its modules do."""

from __future__ import annotations

import re

import pytest

from luxel.app import bundle


def write(folder, **modules):
    for name, source in modules.items():
        (folder / f"{name}.js").write_text(source)


@pytest.fixture
def folder(tmp_path, monkeypatch):
    monkeypatch.setattr(bundle, "CLIENT_FOLDER", tmp_path)
    bundle.client_module.cache_clear()
    yield tmp_path
    bundle.client_module.cache_clear()


def test_modules_come_once_and_after_what_they_import(folder):
    write(
        folder,
        main='// a comment\nimport { two as b } from "./two.js";\nimport * as one from "./one.js";\nexport const sum = b + one.one;\n',
        two='import {\n  one,\n} from "./one.js";\n/** Twice.\n * @returns {number} */\nexport const two = 2 *\n  /** @type {number} */ (one);\n',
        one="export const one = 1;\nexport function unused() {}\nexport async function later() {}\nexport class Thing {}\nconst last = 3;\nexport { last };\n",
    )
    code = bundle.client_module("main")
    assert code.count("one = 1") == 1
    assert code.index("const $one") < code.index("const $two") < code.index("const $main")
    assert "return { one, unused, later, Thing, last };" in code
    assert "const { two: b } = $two;" in code
    assert "const one = $one;" in code
    assert "comment" not in code
    assert "Twice" not in code
    assert "2 *\n(one);" in code
    assert code.endswith("export const { sum } = $main;\n")


@pytest.mark.parametrize(
    ("source", "message"),
    [
        ("export default 3;", "cannot bundle"),
        ("export let x = 3;", "cannot bundle"),
        ("const x = 1;\nexport { x as y };", "cannot bundle"),
        ('export * from "./other.js";', "cannot bundle"),
        ('import "./other.js";', "cannot bundle"),
        ('import what from "./other.js";', "cannot bundle"),
        ('import { gone } from "./other.js";', "gone, which other.js does not export"),
        ('import { x } from "./main.js";', "circle"),
    ],
)
def test_what_would_not_work_is_refused(folder, source, message):
    write(folder, main=source + "\n", other="export const x = 1;\n")
    with pytest.raises(ValueError, match=message):
        bundle.client_module("main")


@pytest.mark.parametrize("entry", ["page", "widget", "file"])
def test_the_client_can_be_bundled(entry):
    code = bundle.client_module(entry)
    assert not re.search(r"^import\b", code, re.MULTILINE)
    assert code.count("class App ") == 1


def test_markup_and_style_hold_no_addresses():
    """Both are put into other people's pages, where the server's files are not."""
    assert '<main id="stage">' in bundle.markup()
    assert "<script" not in bundle.markup()
    assert not re.search(r"(?:src|href|url)\s*[=(]", bundle.markup() + bundle.stylesheet())
