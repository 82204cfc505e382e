"""Studies of tests are not waited for until they are on the disk."""

from __future__ import annotations

import functools
import sqlite3
import types
from collections.abc import Iterator

import pytest

from phase_ppl.study import store


class Hasty(sqlite3.Connection):
    def executescript(self, script: str) -> sqlite3.Cursor:
        return super().executescript(script.replace("synchronous=FULL", "synchronous=OFF"))


@pytest.fixture(autouse=True, scope="module")
def _hasty_databases() -> Iterator[None]:
    connect = functools.partial(sqlite3.connect, factory=Hasty)
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(
            store, "sqlite3", types.SimpleNamespace(**vars(sqlite3) | {"connect": connect})
        )
        yield
