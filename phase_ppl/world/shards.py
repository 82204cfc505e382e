"""Shares of a piece of work, for machines that do not know of each other."""

from __future__ import annotations

import dataclasses
import re
from collections.abc import Sequence
from typing import Final, Self, TypeVar

from phase_ppl.world.errors import InvalidSettingError, shown

SHARD: Final = "shard"  # the setting that says which share of some results is in a folder

Item = TypeVar("Item")


@dataclasses.dataclass(frozen=True)
class Shard:
    """One of ``of`` shares; its ``number`` counts from 1. What is to be done is dealt out in turn.

    So a shard's share follows from the whole and these two numbers alone.
    """

    number: int
    of: int

    @classmethod
    def named(cls, text: object) -> Self:
        """Return the shard of "2/8" (InvalidSettingError: there can be none of that name)."""
        found = re.fullmatch(r"([0-9]{1,9})/([0-9]{1,9})", text if isinstance(text, str) else "")
        if not found or not 1 <= int(found[1]) <= int(found[2]):
            raise InvalidSettingError(
                f"shard={shown(text)}, expected one such as 1/8, the first of eight, to 8/8"
            )
        return cls(int(found[1]), int(found[2]))

    def __str__(self) -> str:
        return f"{self.number}/{self.of}"

    def of_all(self, items: Sequence[Item]) -> list[Item]:
        """Return its share of ``items`` (InvalidSettingError: there is nothing left for it)."""
        if self.number > len(items):
            raise InvalidSettingError(
                f"shard={str(self)!r} would be empty: there is work for {len(items)} at most"
            )
        return list(items[self.number - 1 :: self.of])
