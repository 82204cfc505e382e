"""Clocks of the tests of studies."""

from __future__ import annotations

import time
from types import SimpleNamespace

import pytest


@pytest.fixture
def in_a_moment(monkeypatch: pytest.MonkeyPatch) -> None:
    """However long it takes, it is one moment for the limits of rates."""
    pytest.importorskip("starlette", reason="the extra 'study' is not installed")
    from phase_study import server

    now = time.monotonic()
    stopped = SimpleNamespace(monotonic=lambda: now, time=time.time)
    monkeypatch.setattr(server, "time", stopped)
