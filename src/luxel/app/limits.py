"""How much one page may ask of the server. Free of clocks, input and output."""

from __future__ import annotations

from dataclasses import dataclass

__all__ = ["PAGES_MAX", "Allowance"]

#: Pages that may be connected at once.
PAGES_MAX = 32


@dataclass
class Allowance:
    """A page's messages: so many a second in the long run, and a store of them for short.

    What comes faster waits. The server does not read on meanwhile, so that the sender's own buffers fill and
    nothing is kept here; a page that behaves never notices.

    Parameters
    ----------
    rate
        Units a second; a message costs one, and one more for every `unit_bytes` of it.
    burst
        Units that a rested page may spend at once.
    unit_bytes
        Bytes that cost as much as a message.
    """

    rate: float = 200.0
    burst: float = 400.0
    unit_bytes: int = 64 << 10

    def __post_init__(self) -> None:
        self._left = self.burst
        self._since_s: float | None = None

    def spend(self, nbytes: int, now_s: float) -> float:
        """Note a message of `nbytes` at `now_s`, in seconds; return the seconds to wait before it is acted upon."""
        if self._since_s is not None:
            self._left = min(self.burst, self._left + self.rate * max(0.0, now_s - self._since_s))
        self._since_s = now_s
        self._left -= 1 + nbytes / self.unit_bytes
        return max(0.0, -self._left / self.rate)
