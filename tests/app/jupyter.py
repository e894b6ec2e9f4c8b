"""A real JupyterLab on a free port, with one notebook open in it."""

from __future__ import annotations

import json
import os
import secrets
import subprocess
import sys
import time
from collections.abc import Sequence
from pathlib import Path
from types import TracebackType

import luxel


class Lab:
    """A JupyterLab server; `url` opens `cells` as a notebook. Its kernels use this luxel."""

    def __init__(self, folder: Path, cells: Sequence[str]) -> None:
        token = secrets.token_hex(16)
        runtime = folder / "runtime"
        runtime.mkdir()
        notebook = {
            "cells": [
                {
                    "cell_type": "code",
                    "id": f"cell{k}",
                    "metadata": {},
                    "outputs": [],
                    "execution_count": None,
                    "source": cell,
                }
                for k, cell in enumerate(cells)
            ],
            "metadata": {"kernelspec": {"name": "python3", "display_name": "Python 3", "language": "python"}},
            "nbformat": 4,
            "nbformat_minor": 5,
        }
        (folder / "work").mkdir()
        (folder / "work" / "look.ipynb").write_text(json.dumps(notebook))
        settings = {
            "token": token,
            "root_dir": str(folder / "work"),
            "port": 0,
            "open_browser": False,
            "allow_root": True,
        }
        config = {"ServerApp": settings, "LabApp": {"expose_app_in_browser": True, "news_url": ""}}
        (folder / "jupyter_server_config.json").write_text(json.dumps(config))
        self._log = (folder / "log").open("w+")
        self._process = subprocess.Popen(
            [sys.executable, "-m", "jupyterlab", "--debug"],
            cwd=folder,
            env={
                **os.environ,
                "JUPYTER_CONFIG_DIR": str(folder),
                "JUPYTER_RUNTIME_DIR": str(runtime),
                "JUPYTER_DATA_DIR": str(folder / "data"),
                "JUPYTERLAB_SETTINGS_DIR": str(folder / "settings"),
                "JUPYTERLAB_WORKSPACES_DIR": str(folder / "workspaces"),
                "PYTHONPATH": str(Path(luxel.__file__).parents[1]),
            },
            stdout=self._log,
            stderr=subprocess.STDOUT,
        )
        try:
            self.url = f"{self._address(runtime)}lab/tree/look.ipynb?token={token}"
        except BaseException:
            self.close()
            raise

    def close(self) -> None:
        """End the server and its kernels."""
        self._process.terminate()
        try:
            self._process.wait(20)
        except subprocess.TimeoutExpired:
            self._process.kill()
            self._process.wait()
        self._log.close()

    def __enter__(self) -> Lab:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()

    def _address(self, runtime: Path) -> str:
        """Where it listens; the server writes it to a file once it does."""
        deadline = time.monotonic() + 120
        while time.monotonic() < deadline:
            if self._process.poll() is not None:
                self._log.seek(0)
                raise RuntimeError(f"JupyterLab ended at once:\n{self._log.read()[-4000:]}")
            for found in runtime.glob("jpserver-*.json"):
                text = found.read_text()
                if text:
                    return str(json.loads(text)["url"])
            time.sleep(0.05)  # another process's start: nothing to wait on
        raise TimeoutError("JupyterLab did not start")
