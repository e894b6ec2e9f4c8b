"""Workshops: the bakers of the latest light keys, made when first needed and kept for when a change is undone."""

from __future__ import annotations

from collections import OrderedDict
from collections.abc import Iterator
from dataclasses import dataclass, field

from luxel.dynamic.desk import Kind
from luxel.dynamic.entries import ESTIMATE, FULL
from luxel.dynamic.work import Bakers
from luxel.light.in_view import Gaze

__all__ = ["Workshop", "Workshops"]

_BAKERS_KEPT = 3


@dataclass(eq=False)
class Workshop:
    """Bakers of one light key, and which of them are prepared. Holds no lock: the engine's guards it."""

    bakers: Bakers
    preparing: bool = False
    _prepared: set[int] = field(default_factory=set)
    _steps: dict[int, Iterator[None]] = field(default_factory=dict)

    def grade(self, kind: Kind) -> int:
        """Which textures a kind of work makes."""
        return ESTIMATE if kind is Kind.FIRST_TEXTURE and self.bakers.estimates is not None else FULL

    def is_ready(self, kind: Kind) -> bool:
        """Whether a kind of work can be done."""
        return kind is Kind.FIRST_LIGHT or self.grade(kind) in self._prepared

    def preparation(self, kind: Kind, threads: int, gaze: Gaze | None) -> Iterator[None]:
        """Return the steps that are left before a kind of work can be done; estimates are prepared for who looks."""
        grade = self.grade(kind)
        if grade not in self._steps:
            bakers = self.bakers
            if bakers.estimates is not None and grade == ESTIMATE:
                self._steps[grade] = bakers.estimates.preparation(threads, gaze)
            else:
                self._steps[grade] = bakers.textures.preparation(threads)
        return self._steps[grade]

    def prepared(self, kind: Kind) -> None:
        """Note that all steps are done."""
        self._prepared.add(self.grade(kind))
        self._steps.pop(self.grade(kind), None)

    def outgrown(self, kind: Kind) -> None:
        """Note that what was prepared for a kind of work does not serve any more."""
        self._prepared.discard(self.grade(kind))

    def failed(self, kind: Kind) -> None:
        """Note that a step failed: next time they begin anew."""
        self._steps.pop(self.grade(kind), None)


class Workshops:
    """Workshops by light key. Holds no lock: the engine's guards it."""

    def __init__(self) -> None:
        self._kept: OrderedDict[str, Workshop] = OrderedDict()

    def get(self, key: str) -> Workshop | None:
        """Return the workshop of a light key, marking it as used."""
        shop = self._kept.get(key)
        if shop is not None:
            self._kept.move_to_end(key)
        return shop

    def put(self, key: str, bakers: Bakers) -> None:
        """Add the bakers of a light key; those used longest ago are given up."""
        self._kept[key] = Workshop(bakers)
        while len(self._kept) > _BAKERS_KEPT:
            self._kept.popitem(last=False)
