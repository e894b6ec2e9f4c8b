"""What waits to be sent to a page when another data set is shown."""

from __future__ import annotations

from luxel.app import protocol
from luxel.app.page import Page


def test_answers_and_errors_survive_another_data_set() -> None:
    page = Page("one")
    told = protocol.ParticleState(1, 0, 0, "", "", ())
    error = protocol.Error("no such scalar")
    page.post(("scalar", "value", 0), lambda: protocol.Error("values of the old data set"))
    page.post("particle", lambda: told)
    page.post("scene", lambda: protocol.Error("the old data set"))
    page.post("error", lambda: error)
    page.post(("geometry", 0), lambda: protocol.Error("the old particles"))
    page.clear()
    assert page.next_posted() is told
    assert page.next_posted() is error
    assert page.next_posted() is None
