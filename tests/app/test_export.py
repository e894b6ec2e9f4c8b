"""Exported pages: what is in the file, and what a real browser shows of it from disk, with no network."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from PIL import Image

import luxel
from luxel.app.export import export
from luxel.app.page_file import page_overhead
from luxel.errors import InputError, MissingFileError, ScalarError, StorageError
from luxel.picture.outside import seen_from_outside
from luxel.textures.codecs import train
from luxel.textures.compressed import CompressedTextures
from tests.app.chromium import Browser, Page
from tests.app.pictures import WAIT_S, capture, match
from tests.scenes import cloud, lattice

WINDOW = (360, 260)
SPEC = luxel.TextureSpec(mode="paper", samples=1, texels=8)
RNG = np.random.default_rng(8)


def scene(**options: Any) -> luxel.Scene:
    rng = np.random.default_rng(3)
    positions = rng.uniform(-1, 1, (400, 3))
    scalars = {"heat": positions[:, 0] ** 3, "color": rng.random((400, 3))}
    return luxel.Scene(
        luxel.Particles(positions, rng.uniform(0.1, 0.14, 400), scalars), model="shadows", **options
    )


def test_sizes_are_told_before_and_after(tmp_path: Path) -> None:
    announced: list[Any] = []
    path = tmp_path / "page.html"
    look = luxel.View(color_by="value")
    done = export(cloud(3000, radius=0.05), path, look, spec=SPEC, model="shadows", announce=announced.append)
    # PCA-8 with a scalar: the target of 16 bytes a particle, and 200 kB for the viewer.
    assert done.size.bytes_each == {"positions": 6, "value": 2, "light": 8}
    assert done.size.particle_bytes <= 16
    assert done.size.fixed_bytes <= 200_000
    assert announced == [done.size]
    assert done.file_bytes == path.stat().st_size
    assert page_overhead() < done.file_bytes < 4 / 3 * done.size.raw_bytes + 4096
    assert done.rms_levels is not None


def test_a_page_asks_nobody_for_anything(tmp_path: Path) -> None:
    path = tmp_path / "page.html"
    export(lattice(3), path, spec=SPEC, model="lambertian", title="<script>alert(1)</script>")
    text = path.read_text(encoding="utf-8")
    assert "default-src 'none'" in text
    assert not re.search(r"""(?:src|href)=["'](?!data:)""", text)
    assert "<script>alert" not in text
    assert text.count("</script>") == text.count("<script")


def test_what_cannot_be_written_is_refused_before_the_work(tmp_path: Path) -> None:
    with pytest.raises(MissingFileError, match="no such directory"):
        export(lattice(2), tmp_path / "nowhere" / "page.html")
    with pytest.raises(StorageError, match="is a directory"):
        export(lattice(2), tmp_path)
    with pytest.raises(ScalarError, match="heat"):
        export(lattice(2), tmp_path / "page.html", keep=["heat"], spec=SPEC)
    with pytest.raises(InputError, match="everything is hidden"):
        export(luxel.Scene(lattice(2), hide=luxel.Cut("z", -9)), tmp_path / "page.html", spec=SPEC)
    assert list(tmp_path.iterdir()) == []


def test_an_interruption_leaves_the_old_page(tmp_path: Path) -> None:
    path = tmp_path / "page.html"
    path.write_text("old")

    def interrupt(stage: str, done: int, total: int) -> None:
        if stage == "packing":
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        export(lattice(3), path, spec=SPEC, model="lambertian", progress=interrupt)
    assert [each.name for each in tmp_path.iterdir()] == ["page.html"]
    assert path.read_text() == "old"


def test_what_is_seen_from_outside_is_what_no_view_misses() -> None:
    """A solid block shows its skin only; no view from outside sees what is left out."""
    grid = np.stack(np.meshgrid(*[np.arange(7)] * 3, indexing="ij"), -1).reshape(-1, 3)
    skin = np.minimum(grid, 6 - grid).min(axis=1) == 0
    block = luxel.Scene(luxel.Particles(grid.astype(float), 0.75))  # no way through
    np.testing.assert_array_equal(seen_from_outside(block), np.flatnonzero(skin))
    loose = luxel.Scene(cloud(4000, radius=0.04, spread=0.3), model="lambertian")
    seen = seen_from_outside(loose)
    assert 0.2 * 4000 < len(seen) < 0.9 * 4000
    for _ in range(6):
        towards = RNG.normal(size=3)
        eye = 0.5 + 3 * towards / np.linalg.norm(towards)
        look = luxel.View(camera=luxel.Camera(eye, (0.5, 0.5, 0.5), up=(0.1, 0.2, 1)))
        picture = luxel.render(loose, look, size=(200, 200), antialias=1)
        missed = ~np.isin(picture.ids, np.append(seen, -1))
        assert missed.mean() < 2e-4


@pytest.mark.browser
@pytest.mark.parametrize("case", ["heat", "color", "visible", "raw", "hidden"])
def test_the_page_shows_the_ray_tracers_picture_from_disk(
    tmp_path: Path, browser: Browser, case: str
) -> None:
    lit = scene(hide=luxel.Cut("x", 0.3)) if case == "hidden" else scene()
    camera = luxel.Camera((2.2, -3.5, 1.6), (0, 0, 0), fov=38)
    look = luxel.View(camera=camera, color_by="heat", colormap="plasma")
    if case == "color":
        look = look.with_changes(color_by="color", colormap="rgb")
    codec = luxel.CodecChoice() if case == "raw" else None
    path = tmp_path / "page.html"
    export(lit, path, look, spec=SPEC, codec=codec, visible_only=case == "visible")
    with Page("about:blank", WINDOW, browser=browser) as page:
        page.call("Network.enable")
        page.call(
            "Network.emulateNetworkConditions",
            offline=True,
            latency=0,
            downloadThroughput=0,
            uploadThroughput=0,
        )
        page.call("Page.navigate", url=path.as_uri())
        page.wait("window.luxel && document.getElementById('fold').click() === undefined", WAIT_S)
        page.wait(
            "(s => s.known && s.visible > 0 && s.ready === s.visible && s.coloring)(luxel.state())", WAIT_S
        )
        pixels, ids = capture(page)
        kept = page.run("luxel.app.connection.ids && [...luxel.app.connection.ids]")
        assert page.run("luxel.state().troubles") == {}
        if case == "heat":
            # No server could draw it in another size: what is on the canvas is saved.
            saved = tmp_path / "saved"
            page.call("Page.setDownloadBehavior", behavior="allow", downloadPath=str(saved))
            assert page.run("document.getElementById('save-size').hidden")
            assert page.run("document.getElementById('drawn-by-row').hidden")
            page.run("document.getElementById('save').click()")
            page.wait("0", WAIT_S, lambda _: list(saved.glob("*.png")))
            with Image.open(next(saved.glob("*.png"))) as picture:
                assert picture.size == ids.shape[::-1]
        requests = page.requests
    if kept is not None:
        ids = np.append(np.array(kept), -1)[ids]
    baked = luxel.bake(lit, samples=1, mode="paper", texels=8)
    shown = np.isin(baked.ids, baked.ids if kept is None else kept)
    made = train(
        "raw" if case == "raw" else "pca", baked.codes[shown], **({} if case == "raw" else {"components": 8})
    )
    picture = luxel.render(
        lit, look, CompressedTextures.of(baked, made), ids.shape[::-1], antialias=1, colorbar=False
    )
    match(pixels, ids, picture, f"export-{case}")
    assert [url for url in requests if not url.startswith(("file:", "data:", "blob:", "about:"))] == []
    assert [text for text in page.messages if "performance warning" not in text] == []
