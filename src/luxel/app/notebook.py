"""Whether this is a notebook's kernel, and the widget for it."""

from __future__ import annotations

import importlib.util
import sys
from typing import TYPE_CHECKING

from luxel.errors import MissingExtraError
from luxel.session import Session

if TYPE_CHECKING:
    from luxel.app.hub import Renderer
    from luxel.app.widget import ViewerWidget

__all__ = ["in_notebook", "make_widget"]


def in_notebook() -> bool:
    """Whether the process is the kernel of a notebook: JupyterLab, Notebook, VS Code, Colab (all IPython) or marimo."""
    marimo = sys.modules.get("marimo")
    if marimo is not None and marimo.running_in_notebook():
        return True
    ipython = sys.modules.get("IPython")
    shell = None if ipython is None else ipython.get_ipython()
    return getattr(shell, "kernel", None) is not None  # IPython in a terminal has none


def make_widget(
    session: Session, height: int, owns_session: bool, renderer: Renderer = "browser"
) -> ViewerWidget:
    """Return the viewer as a widget.

    Raises
    ------
    MissingExtraError
        Without anywidget.
    """
    if importlib.util.find_spec("anywidget") is None:
        raise MissingExtraError("a viewer in a notebook", "jupyter")
    from luxel.app.widget import ViewerWidget

    return ViewerWidget(session, height=height, owns_session=owns_session, renderer=renderer)
