"""One piece of work in shares that several threads do together."""

from __future__ import annotations

from collections.abc import Callable
from typing import Protocol, TypeVar

__all__ = ["Helpers", "in_shares"]

_SHARES_A_THREAD = 2  # so that no thread waits long for the last share
_LEAST_SHARE = 4

Result = TypeVar("Result")


class Helpers(Protocol):
    """Threads that do one thing together, such as those that draw."""

    @property
    def threads(self) -> int:
        """How many, the caller's included."""
        ...

    def run(self, work: Callable[[], object]) -> None:
        """Call `work` on every thread at once and wait for all; re-raise an error."""
        ...


def in_shares(work: Callable[[slice], Result], count: int, helpers: Helpers | None) -> list[Result]:
    """Return the results of `work` for consecutive shares of `count` things, done by the caller and its helpers."""
    shares = 1
    if helpers is not None and helpers.threads > 1:
        shares = max(1, min(_SHARES_A_THREAD * helpers.threads, count // _LEAST_SHARE))
    edges = [count * k // shares for k in range(shares + 1)]
    if helpers is None or shares == 1:
        return [work(slice(0, count))]
    found: dict[int, Result] = {}
    numbers = iter(range(shares))

    def some() -> None:
        for k in numbers:
            found[k] = work(slice(edges[k], edges[k + 1]))

    helpers.run(some)
    return [found[k] for k in range(shares)]
