"""Two people at two browsers, by keyboard alone."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

pytest.importorskip("starlette", reason="the extra 'study' is not installed")
from phase_ppl.study import play
from phase_ppl.study.simulate import serving
from phase_ppl.study.study import Study
from tests.browser import needs_browser, running_browser
from tests.study.players import make_study, near_goals

pytestmark = needs_browser


@pytest.fixture(autouse=True)
def _no_films(monkeypatch: pytest.MonkeyPatch) -> None:
    """The introduction is read already, so that its films need not be there."""
    monkeypatch.setattr(Study, "check", lambda study: [])


AXE = Path(__file__).parent / "vendor" / "axe.min.js"


@pytest.fixture(scope="module")
def browser() -> Iterator[Any]:
    with running_browser() as found:
        yield found


_REMEMBERS_SOCKETS = """
const Real = WebSocket;
window.sockets = [];
window.WebSocket = class extends Real {
  constructor(...given) { super(...given); window.sockets.push(this); }
};
"""


class Window:
    """A browser of somebody's own, who has read the introduction."""

    def __init__(self, browser: Any, study: Study, address: str, practised: bool = True) -> None:
        self.faults: list[str] = []
        self.context = browser.new_context(viewport={"width": 1280, "height": 720})
        self.context.add_init_script(_REMEMBERS_SOCKETS)
        self.page = self.context.new_page()
        self.page.on("console", self._said)
        self.page.on("pageerror", lambda error: self.faults.append(str(error)))
        self.page.on("request", lambda request: self._asked(request.url, address))
        self.post(address, "enter")
        for page, answers in (
            ("consent", {"agree": True}),
            ("device", {}),
            ("tutorial", {"views": []}),
        ):
            self.post(address, "answer", page=page, attempt=1, answers=answers)
        who = self.context.request.get(f"{address}api/state").json()["participant"]
        if practised:
            with study.store() as store:
                store.answer(who, "practice", 1, {})
        self.page.goto(address)

    def post(self, address: str, what: str, **content: Any) -> None:
        headers = {"origin": address.rstrip("/")}
        reply = self.context.request.post(f"{address}api/{what}", data=content, headers=headers)
        assert reply.ok, reply.text()

    def _said(self, message: Any) -> None:
        if message.type in ("error", "warning"):
            self.faults.append(message.text)

    def _asked(self, url: str, address: str) -> None:
        if not url.startswith((address, "blob:", "data:")):
            self.faults.append(f"asked for {url}")

    def sees(self, text: str) -> None:
        self.page.get_by_text(text).first.wait_for(timeout=20_000)

    def colours(self) -> int:
        """How many colours the picture has."""
        return int(
            self.page.evaluate(
                """() => { const c = document.querySelector("canvas");
                const p = new Uint32Array(c.getContext("2d").getImageData(0, 0, c.width, c.height)
                  .data.buffer); return new Set(p).size; }"""
            )
        )

    def violations(self) -> list[str]:
        """What axe finds against WCAG A and AA."""
        self.page.evaluate(AXE.read_text("utf-8"))
        tags = ["wcag2a", "wcag2aa", "wcag21a", "wcag21aa", "wcag22aa"]
        found = self.page.evaluate(
            "tags => axe.run({ runOnly: tags }).then(found => found.violations)", tags
        )
        return [f"{one['id']}: {one['nodes'][0]['html']}" for one in found]


def test_two_windows_play_a_session_that_ends_by_its_goals(
    tmp_path: Path, browser: Any, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(play, "COUNTDOWN", 1)
    study = make_study(tmp_path / "study", [near_goals()], steps_per_second=8, limit=200, hold=4)
    with serving(study) as address:
        windows = [Window(browser, study, address)]
        windows[0].sees("Looking for another player")
        assert windows[0].violations() == []
        windows.append(Window(browser, study, address))
        for window in windows:
            window.sees("Session 1 of 1")
            window.sees("get the red agent to the blue landmark")
            assert window.page.locator("button:focus").text_content() == "I am ready"
            assert window.violations() == []
        for window in windows:
            window.page.keyboard.press("Enter")
        for window in windows:
            window.sees("Time left:")
            assert window.page.get_by_role("img").get_attribute("aria-label")
            assert window.page.locator("canvas:focus").count() == 1
        windows[0].page.keyboard.down("w")
        windows[1].page.keyboard.down("ArrowUp")
        for window in windows:
            assert window.colours() > 5
        for window in windows:
            window.sees("Both goals are reached!")
        for window in windows:
            window.sees("Thank you!")
            code = window.page.locator("#code").text_content()
            assert code == study.settings.codes["finished"]
            assert window.faults == []
    with study.store() as store:
        (session,) = store.sessions()
    assert session["outcome"] == "goals"
    assert all(player["rtt_ms"] is None or player["rtt_ms"] > 0 for player in session["players"])


def test_a_window_that_loses_its_connection_finds_back(
    tmp_path: Path, browser: Any, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(play, "COUNTDOWN", 0)
    study = make_study(
        tmp_path / "study", [near_goals()], partner="computer", hold=100, limit=100,
        rejoin_within=30,
    )  # fmt: skip
    with serving(study) as address:
        window = Window(browser, study, address, practised=False)
        window.sees("Please do this")
        window.page.keyboard.down("w")
        window.sees("1 of 5 done")
        assert window.violations() == []
        window.page.keyboard.up("w")
        window.page.reload()
        window.sees("1 of 5 done")  # the practice goes on where it was
        window.page.evaluate("() => window.sockets.at(-1).close()")
        window.sees("The connection is lost")
        window.page.get_by_text("The connection is lost").wait_for(state="detached", timeout=20_000)
        window.page.keyboard.press("q")
        window.sees("2 of 5 done")
        other = window.context.new_page()
        other.goto(address)
        window.sees("goes on in another window")
        other.get_by_text("2 of 5 done").wait_for(timeout=20_000)
