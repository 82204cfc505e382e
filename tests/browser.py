"""The browser of the tests: Debian's Chromium, or another that is here."""

from __future__ import annotations

import contextlib
import os
import shutil
from collections.abc import Iterator
from typing import Any

import pytest

NAMES = ("chromium", "chromium-headless-shell", "chromium-browser", "google-chrome")

_named = os.environ.get("CHROMIUM")
BROWSER = shutil.which(_named) if _named else next(filter(None, map(shutil.which, NAMES)), None)

WHY = f"there is no browser here ($CHROMIUM, or {', '.join(NAMES)})"

needs_browser = pytest.mark.skipif(BROWSER is None, reason=WHY)


def browser_path() -> str:
    if BROWSER is None:
        pytest.fail(WHY)
    return BROWSER


@contextlib.contextmanager
def running_browser() -> Iterator[Any]:
    """Yield a running browser, as Playwright has it; without Playwright the test is skipped."""
    playwright = pytest.importorskip("playwright.sync_api", reason="there is no Playwright")
    with playwright.sync_playwright() as running:
        # a sandbox is not to be had by root, much shared memory not in a container
        found = running.chromium.launch(
            executable_path=browser_path(),
            args=["--no-sandbox", "--disable-dev-shm-usage"],
            timeout=180_000,
        )
        yield found
        found.close()
