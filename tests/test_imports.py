import shutil
import subprocess
import sys
from pathlib import Path

import pytest

import luxel

ROOT = Path(__file__).parents[1]


def python(code):
    path = [str(Path(luxel.__file__).parents[1])]
    return subprocess.run(
        [sys.executable, "-c", f"import sys; sys.path[:0] = {path}\n{code}"],
        capture_output=True,
        text=True,
        timeout=120,
        check=False,
    )


def test_import_loads_nothing_but_numpy():
    done = python("import luxel; print(*sorted({name.partition('.')[0] for name in sys.modules}))")
    assert done.returncode == 0, done.stderr
    third_party = set(done.stdout.split()) - set(sys.stdlib_module_names) - {"luxel", "__main__"}
    third_party = {name for name in third_party if not name.startswith("_")}
    assert third_party <= {"numpy"}


@pytest.mark.parametrize("name", ["Particles", "Scene", "View", "Camera", "Sky", "TextureSpec", "LuxelError"])
def test_values_load_nothing_heavy(name):
    done = python(f"import luxel; luxel.{name}; print(*sys.modules)")
    assert done.returncode == 0, done.stderr
    heavy = {
        "numba",
        "scipy",
        "matplotlib",
        "asyncio",
        "starlette",
        "uvicorn",
        "websockets",
        "PIL",
        "tqdm",
        "vtk",
        "gsd",
        "anywidget",
        "ipywidgets",
        "traitlets",
    }
    assert not heavy & set(done.stdout.split())


def test_a_default_view_colors_uniformly_without_matplotlib():
    code = "import luxel; p = luxel.Particles([[0, 0, 0]], 1); luxel.View().colors(p); assert 'matplotlib' not in sys.modules"
    assert python(code).returncode == 0


@pytest.mark.parametrize("name", luxel.__all__)
def test_public_names_resolve(name):
    assert getattr(luxel, name) is not None


def test_unknown_names_are_attribute_errors():
    with pytest.raises(AttributeError, match="rendr"):
        luxel.rendr  # noqa: B018
    assert dir(luxel) == luxel.__all__


def test_layers():
    tool = shutil.which("lint-imports") or str(Path(sys.executable).with_name("lint-imports"))
    if not Path(tool).exists():
        pytest.fail("lint-imports is not installed: pip install 'luxel[test]'")
    done = subprocess.run(
        [tool, "--no-cache", "--config", str(ROOT / "pyproject.toml")],
        capture_output=True,
        text=True,
        timeout=300,
        check=False,
        cwd=ROOT / "src",
    )
    assert done.returncode == 0, done.stdout + done.stderr
