"""A real browser goes through studies, from consent to the code."""

from __future__ import annotations

import contextlib
import dataclasses
import json
import re
import shutil
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest

pytest.importorskip("starlette", reason="the extra 'study' is not installed")

import phase_ppl as ppl
from phase_ppl.evaluation.prediction import questions_of
from phase_ppl.physics.actions import Action
from phase_study import plan, play
from phase_study.clips import CLIPS, make_clips
from phase_study.simulate import serving
from phase_study.study import Study
from tests.browser import needs_browser, running_browser
from tests.simulator.toys import wait_until
from tests.study import players
from tests.study.studies import JUDGED, STILL, make_study, quiz, rows, table

AXE = (Path(__file__).parent / "vendor" / "axe.min.js").read_text("utf-8")
RULES = ["wcag2a", "wcag2aa", "wcag21a", "wcag21aa", "wcag22aa"]
WAIT = 60_000

# Films are slow until they are watched, so that none is over before; and what the page says is
# kept, as it may be gone when it is looked for.
_BEFORE = """
window.said = new Set();
new MutationObserver(() => {
  const says = document.querySelectorAll("[role=status], [role=alert]");
  for (const one of says) window.said.add(one.textContent);
}).observe(document, { subtree: true, childList: true, characterData: true });
addEventListener("play", ({ target: film }) => {
  if (!film.watched) film.playbackRate = 0.0625;
}, true);
"""


@pytest.fixture(scope="module")
def browser() -> Iterator[Any]:
    with running_browser() as found:
        yield found


@pytest.fixture(scope="module")
def clips(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Films of the introduction, all but the first of an instant."""
    folder = tmp_path_factory.mktemp("films") / "clips"
    with pytest.MonkeyPatch.context() as patch:
        moves = [(Action.UP, 8)]
        short = dict.fromkeys(CLIPS, STILL)
        short["moving"] = dataclasses.replace(CLIPS["moving"], red=moves, green=moves)
        patch.setattr("phase_study.clips.CLIPS", short)
        make_clips(folder)
    return folder


class Window:
    """Somebody's browser: what it complains of is kept, as is what it asks of others.

    Args:
        browser: running.
        address: of the study.
        options: ``size`` of screen and window, ``script`` to run first, ``query`` of the address.
    """

    accessible = False
    """Whether each page that it sees is looked through for what keeps people out."""

    expected: tuple[str, ...] = ("Failed to load resource", "net::ERR_INTERNET_DISCONNECTED")
    leave: Callable[[], object]
    """Ends the server: all that it was told is kept by then."""

    def __init__(self, browser: Any, study: Study, address: str, **options: Any) -> None:
        size = options.pop("size", {"width": 1280, "height": 720})
        script, self.query = options.pop("script", None), options.pop("query", "")
        self.study, self.address = study, address
        self.faults: list[str] = []
        self.seen: set[str] = set()
        self.context = browser.new_context(viewport=size, screen=size, **options)
        self.context.add_init_script(_BEFORE)
        if script:
            self.context.add_init_script(script)
        self.begin()
        self.page = self.tab()

    def begin(self) -> None:
        """Do what comes before the page is opened."""

    def tab(self) -> Any:
        page = self.context.new_page()
        page.set_default_timeout(WAIT)
        page.on("console", lambda message: self._said(message))
        page.on("pageerror", lambda error: self.faults.append(str(error)))
        page.on("request", lambda request: self._asked(request.url))
        page.goto(f"{self.address}{self.query}")
        return page

    def _said(self, message: Any) -> None:
        if message.type in ("error", "warning") and not message.text.startswith(self.expected):
            self.faults.append(message.text)

    def _asked(self, url: str) -> None:
        if not url.startswith((self.address, "blob:", "data:")):
            self.faults.append(f"asked for {url}")

    def sees(self, heading: str) -> None:
        self.page.get_by_role("heading", name=heading, exact=True, level=1).wait_for()
        assert self.page.evaluate("document.activeElement.tagName") == "H1"
        kind = re.sub(r"\d+", "", heading)
        if self.accessible and kind not in self.seen:
            self.is_accessible()
        self.seen.add(kind)

    def is_accessible(self) -> None:
        self.page.evaluate(AXE)
        found = self.page.evaluate(
            "tags => axe.run({ runOnly: tags }).then(all => all.violations)", RULES
        )
        assert [(one["id"], one["nodes"][0]["html"]) for one in found] == []

    def press(self, name: str) -> None:
        self.page.get_by_role("button", name=name, exact=True).click()

    def watch(self) -> None:
        """See a film to its end, fast."""
        self.page.evaluate(
            "Object.assign(document.querySelector('video'), { watched: true, playbackRate: 16 })"
        )
        self.page.get_by_role("button", name="Play again").wait_for()

    def says(self, text: str) -> None:
        self.page.get_by_text(text).first.wait_for()

    def has_said(self, text: str) -> None:
        """Wait for a status or an alert that may be gone soon."""
        script = "text => [...window.said].some(one => one.includes(text))"
        wait_until(lambda: self.page.evaluate(script, text), WAIT / 1000)

    def no_longer_says(self, text: str) -> None:
        self.page.get_by_text(text).wait_for(state="detached")

    # --- page by page

    def agree(self) -> None:
        self.sees(self.study.settings.title)
        self.press("I agree and take part")
        self.sees("Your screen")

    def see_the_screen(self) -> None:
        self.press("Next")
        self.says("Please watch the animation to its end first.")
        self.watch()
        self.press("Next")

    def read(self) -> None:
        steps = len(self.study.settings.tutorial)
        for number in range(1, steps + 1):
            self.says(f"{number} of {steps}")
            self.sees("Introduction")
            self.press("Next")

    def answer_quiz(self, right: bool = True) -> None:
        self.sees("What the introduction said")
        given = quiz(self.study, right)
        for number, (question, _, _) in enumerate(self.study.settings.quiz, 1):
            group = self.page.get_by_role("group", name=question)
            group.get_by_label(given[f"question_{number}"], exact=True).check()
        self.press("Done")

    def judge(self, relation: str = "neutral") -> None:
        """Answer the questions of a trial, whatever they are."""
        kind = self.study.settings.kind
        own = "get the blue item to the red landmark", "get away from the red agent"
        labels = ("chasing", "helping") if kind == "tagging" else (*own, relation)
        for label in (*labels, *["4"] * (kind == "likeness")):
            self.page.get_by_label(label, exact=True).first.check()
        self.press("Next")

    @property
    def id(self) -> str:
        (only,) = rows(self.study, "SELECT id FROM participant WHERE token IS NOT NULL")
        return str(only["id"])


class Careful(Window):
    accessible = True


class Prepared(Window):
    """The window of somebody who has read the introduction, and passed its quiz if there is one."""

    def begin(self) -> None:
        self.post("enter")
        given: dict[str, dict[str, Any]] = {
            "consent": {"agree": True}, "device": {}, "tutorial": {"views": []}
        }  # fmt: skip
        if self.study.settings.quiz:
            given["quiz"] = quiz(self.study)
        for page, answers in given.items():
            self.post("answer", page=page, attempt=1, answers=answers)

    def post(self, what: str, **content: Any) -> None:
        headers = {"origin": self.address.rstrip("/")}
        reply = self.context.request.post(
            f"{self.address}api/{what}", data=content, headers=headers
        )
        assert reply.ok, reply.text()


Opened = Callable[..., Any]


@pytest.fixture
def opened(browser: Any) -> Iterator[Opened]:
    """Serve a study, unless it is served already, and open a window of some class onto it."""
    with contextlib.ExitStack() as at_the_end:

        def make(
            study: Study, window: type[Window] = Window, address: str = "", **options: Any
        ) -> Window:
            server = at_the_end.enter_context(contextlib.ExitStack())
            address = address or server.enter_context(serving(study))
            found = window(browser, study, address, **options)
            # a page that is left open would go on drawing, and asking for its server
            at_the_end.callback(found.context.close)
            found.leave = server.close
            return found

        yield make


@pytest.fixture
def made(tmp_path: Path, clips: Path) -> Callable[..., Study]:

    def make(kind: str = "judgment", **given: Any) -> Study:
        study = make_study(tmp_path / "study", kind, filmed=True, **given)
        shutil.copytree(clips, study.folder / "clips", dirs_exist_ok=True)
        return study

    return make


@needs_browser
@pytest.mark.parametrize(
    "kind",
    ["judgment", *(pytest.param(k, marks=pytest.mark.slow) for k in ("tagging", "likeness"))],
)
def test_from_consent_to_the_code(opened: Opened, made: Any, kind: str) -> None:
    study = made(kind, refuse_repeats="PROLIFIC_PID")
    stumbles = kind == "judgment"  # over what is the same for all kinds
    window = opened(study, Careful, query="?PROLIFIC_PID=77abc")
    window.agree()
    window.see_the_screen()
    assert window.page.url == window.address, "a platform's id is not left in the address"
    if stumbles:
        window.read()
        window.answer_quiz(right=False)
        window.says("Some of these answers were not right")
    window.read()
    window.answer_quiz()

    window.sees("Animation 1 of 3")
    size = "[document.documentElement.scrollWidth, document.documentElement.scrollHeight]"
    width, height = window.page.evaluate(size)
    assert width <= 1280
    assert height <= 720, "film and questions at once"
    window.page.set_viewport_size({"width": 640, "height": 360})  # as a zoom of 200 % does
    assert window.page.evaluate(size)[0] <= 640, "nothing is to the right of the window"
    window.page.set_viewport_size({"width": 1280, "height": 720})
    window.watch()
    window.press("Next")
    window.says("still open")
    window.is_accessible()
    window.judge()

    window.sees("Animation 2 of 3")
    if stumbles:
        window.page.reload()  # in the middle
        window.sees("Animation 2 of 3")
    window.watch()
    window.context.set_offline(stumbles)
    window.judge()
    window.sees("Animation 3 of 3")
    if stumbles:
        window.says("There is no connection.")
        pages = "SELECT count(*) AS n FROM response WHERE page LIKE 'trial-%'"
        assert rows(study, pages) == [{"n": 1}]
        window.context.set_offline(False)
        window.no_longer_says("There is no connection.")
        assert rows(study, pages) == [{"n": 2}]
    window.watch()
    window.judge()

    window.sees("About you")
    window.page.get_by_label("Your age").fill("44")
    window.press("Next")
    window.sees(study.settings.title)
    assert window.page.locator("#code").text_content() == study.settings.codes["finished"]
    window.says(window.id)
    window.is_accessible()
    if stumbles:
        window.page.reload()
        window.says("Your completion code")
    assert window.page.evaluate("Object.keys(localStorage)") == []
    assert window.faults == []

    window.leave()
    quizzes = rows(study, "SELECT correct FROM response WHERE page='quiz' ORDER BY attempt")
    assert [quiz["correct"] for quiz in quizzes] == ([0, 1] if stumbles else [1])
    trials = rows(study, "SELECT * FROM response WHERE page LIKE 'trial-%' ORDER BY page")
    assert [trial["attempt"] for trial in trials] == [1, 1, 1]
    for trial in trials:
        assert 0 < trial["first_end_ms"] <= trial["rt_ms"]
        assert trial["plays"] >= 1
    assert rows(study, "SELECT age, gender FROM person") == [{"age": 44, "gender": None}]
    notes = {note["what"] for note in rows(study, "SELECT what FROM note")}
    assert {"resume", "retry"} <= notes or not stumbles
    assert study.status().counts["finished"] == 1
    everything = b"".join(file.read_bytes() for file in study.folder.glob("study.db*"))
    for word in (b"77abc", b"127.0.0.1", b"Mozilla"):
        assert word not in everything, "nothing by which a person could be known"


@needs_browser
def test_a_second_tab_goes_on_where_the_first_is(opened: Opened, made: Any) -> None:
    window = opened(made(), Prepared)
    window.sees("Animation 1 of 3")
    first, window.page = window.page, window.tab()
    window.sees("Animation 1 of 3")
    second, window.page = window.page, first
    for number in (2, 3):
        window.watch()
        window.judge("friendly")
        window.sees(f"Animation {number} of 3")
    window.page = second
    window.watch()
    window.judge("adversarial")  # of the first animation, a second time
    window.sees("Animation 3 of 3")
    assert window.faults == []
    window.leave()
    answers = rows(window.study, "SELECT page, answers FROM response WHERE page LIKE 'trial-%'")
    assert sorted((row["page"], json.loads(row["answers"])["relation"]) for row in answers) == [
        ("trial-1", "friendly"),
        ("trial-2", "friendly"),
    ]


@needs_browser
def test_the_keyboard_alone_suffices(opened: Opened, made: Any) -> None:
    window = opened(made())
    keys, settings = window.page.keyboard, window.study.settings

    def go_to(text: str, then: str = "", part: str = "textContent") -> None:
        """Press Tab until something with such a text has the focus, then another key."""
        for _ in range(40):
            keys.press("Tab")
            found = f"(document.activeElement.{part} ?? '')"
            if window.page.evaluate(found) == text:
                return keys.press(then) if then else None
        pytest.fail(f"the keyboard does not get to {text!r}")

    def choose(name: str, downs: int) -> None:
        go_to(name, "Space", "name")
        for _ in range(downs):
            keys.press("ArrowDown")

    window.sees(settings.title)
    go_to("I agree and take part", "Enter")
    window.sees("Your screen")
    window.watch()
    go_to("Next", "Space")
    for number in range(1, len(settings.tutorial) + 1):
        window.says(f"{number} of {len(settings.tutorial)}")
        go_to("Next", "Enter")
    window.sees("What the introduction said")
    for number, (_, options, answer) in enumerate(settings.quiz, 1):
        choose(f"question_{number}", options.index(answer))
    keys.press("Enter")
    window.sees("Animation 1 of 3")
    window.watch()
    go_to("Play again", "Enter")
    window.watch()
    for name, downs in (("goal_red", 2), ("goal_green", 33), ("relation", 1)):
        choose(name, downs)
    go_to("Next", "Enter")
    window.sees("Animation 2 of 3")
    assert window.faults == []
    window.leave()
    (answer,) = rows(window.study, "SELECT answers, plays FROM response WHERE page='trial-1'")
    assert (json.loads(answer["answers"]), answer["plays"]) == (JUDGED, 2)


_REFUSES = """
const play = HTMLMediaElement.prototype.play;
HTMLMediaElement.prototype.play = function () {
  if (this.asked) return play.call(this);
  this.asked = true;
  return Promise.reject(new DOMException("not now", "NotAllowedError"));
};
"""


@needs_browser
def test_a_film_stops_and_sliders_are_moved_by_keys(opened: Opened, made: Any) -> None:
    window = opened(made(answers="sliders", moments=[0.25, 0.5]), Prepared)
    window.sees("Animation 1 of 3")
    stopped = "The animation has stopped."
    own = "get the blue item to the red landmark", "get away from the red agent"
    play = "Object.assign(document.querySelector('video'), { watched: true, playbackRate: 1 })"
    window.page.evaluate(play)
    # a device so slow that the film is over before the page can stop it
    window.page.evaluate("() => { const at = Date.now(); while (Date.now() < at + 1500); }")
    for stop, at in enumerate((0.25, 0.5)):
        # the words of the first stop may still be there
        there = f"document.querySelector('video').currentTime == {at}"
        wait_until(lambda script=there: window.page.evaluate(script), 30)
        window.says(stopped)
        window.is_accessible()
        for label in own:
            window.page.get_by_label(label, exact=True).first.check()
        window.press("Next")
        if stop == 0:
            window.says("still open")  # no slider was moved
            window.page.evaluate("window.requestAnimationFrame = () => 0")  # as in a hidden page
            window.page.evaluate("document.querySelector('video').playbackRate = 0.5")
            slider = window.page.get_by_role("slider", name="neutral")
            slider.focus()
            for _ in range(3):
                window.page.keyboard.press("ArrowRight")
            window.press("Next")
    window.page.get_by_role("button", name="Play again").wait_for()
    window.press("Next")
    window.sees("Animation 2 of 3")
    assert window.faults == []
    window.leave()
    (answer,) = rows(window.study, "SELECT answers FROM response WHERE page='trial-1'")
    said = json.loads(answer["answers"])
    assert [stop["at"] for stop in said["moments"]] == [0.25, 0.5]
    for given in (said, *said["moments"]):
        assert given["relation"] == {"friendly": 0, "neutral": 3, "adversarial": 0}


@needs_browser
def test_no_film_and_a_small_screen_are_told_and_noted(opened: Opened, made: Any) -> None:
    window = opened(made(), size={"width": 390, "height": 844}, script=_REFUSES)
    window.page.route("**/clip/moving.mp4", lambda route: route.fulfill(body=b"no film"))
    window.agree()
    window.says("The animation cannot be shown.")
    window.page.unroute("**/clip/moving.mp4")
    window.page.reload()
    window.sees("Your screen")
    window.says("Press the button to start the animation.")
    window.press("Play")
    window.see_the_screen()
    window.says("this device will not do")
    window.is_accessible()
    window.page.reload()
    window.sees("Your screen")
    window.leave()
    notes = {note["what"]: note["detail"] for note in rows(window.study, "SELECT * FROM note")}
    assert {"video error", "autoplay refused", "device refused"} <= set(notes)
    assert notes["device refused"] == 390


@needs_browser
def test_leaving_asks_only_while_something_is_unsent(opened: Opened, made: Any) -> None:
    asked: list[str] = []
    window = opened(made(), Prepared)

    def leave_and_come_back() -> None:
        window.page.on("dialog", lambda dialog: (asked.append(dialog.type), dialog.accept()))
        with window.page.expect_event("close"):
            window.page.close(run_before_unload=True)
        window.context.set_offline(False)
        window.page = window.tab()

    window.sees("Animation 1 of 3")
    window.watch()
    leave_and_come_back()
    window.sees("Animation 1 of 3")
    assert asked == []
    window.watch()
    window.context.set_offline(True)
    window.judge()
    window.sees("Animation 2 of 3")
    leave_and_come_back()
    window.sees("Animation 2 of 3")
    assert asked == ["beforeunload"]
    window.leave()  # what was not sent came later
    assert len(rows(window.study, "SELECT * FROM response WHERE page='trial-1'")) == 1


@needs_browser
def test_a_full_study_and_an_unwilling_person_are_told_so(opened: Opened, made: Any) -> None:
    window = opened(made(most_entries=1))
    window.sees(window.study.settings.title)
    window.press("I do not agree")
    window.says("You have not taken part")
    other = opened(window.study, address=window.address)
    other.says("No places left")
    other.is_accessible()
    assert window.faults == other.faults == []


@needs_browser
def test_a_study_of_three_agents_asks_for_the_goals_of_all(opened: Opened, tmp_path: Path) -> None:
    trio = ppl.worlds.TRIO
    study = make_study(tmp_path / "study", world=trio, filmed=True, trials=1)
    window = opened(study, Prepared)
    window.sees("Animation 1 of 1")
    window.is_accessible()
    window.watch()
    window.press("Next")
    window.says("6 questions are still open.")
    window.page.evaluate("window.scrollTo(0, 400)")
    assert window.page.locator("video").bounding_box()["y"] >= 0, "the film stays in view"
    given = {}
    for place, question in enumerate(plan.questions(study.settings, "trial-1")):
        options = question["options"]
        given[question["name"]], words = options[(17 + 5 * place) % len(options)]
        group = window.page.get_by_role("group", name=question["legend"])
        group.get_by_label(words, exact=True).check()
    window.press("Next")
    window.sees("About you")
    window.press("Next")
    window.sees(study.settings.title)
    assert window.faults == []
    (row,) = table(study.export(tmp_path / "out") / "judgments.csv")
    assert {question: row[question] for question in questions_of(trio)} == given


# --- play -----------------------------------------------------------------------------------------


_REMEMBERS_SOCKETS = """
const Real = WebSocket;
window.sockets = [];
window.WebSocket = class extends Real {
  constructor(...given) { super(...given); window.sockets.push(this); }
};
"""


class Beginner(Prepared):
    """The window of a player who has read the introduction; ``sockets`` are those of the page."""

    expected = ()

    def __init__(self, browser: Any, study: Study, address: str) -> None:
        super().__init__(browser, study, address, script=_REMEMBERS_SOCKETS)

    def colours(self) -> int:
        script = """() => { const c = document.querySelector("canvas");
            const p = new Uint32Array(c.getContext("2d").getImageData(0, 0, c.width, c.height)
              .data.buffer); return new Set(p).size; }"""
        return int(self.page.evaluate(script))


class Player(Beginner):
    """The window of somebody who has practised, too."""

    def begin(self) -> None:
        super().begin()
        who = self.context.request.get(f"{self.address}api/state").json()["participant"]
        with self.study.store() as store:
            store.answer(who, "practice", 1, {})


@pytest.fixture
def played(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Callable[..., Study]:
    """Make a study of play; its introduction is read already, so that no films need be there."""
    monkeypatch.setattr(Study, "check", lambda study: [])

    def make(countdown: int, **given: Any) -> Study:
        monkeypatch.setattr(play, "COUNTDOWN", countdown)
        return players.make_study(tmp_path / "study", [players.near_goals()], **given)

    return make


@needs_browser
def test_two_windows_play_a_session_that_ends_by_its_goals(opened: Opened, played: Any) -> None:
    study = played(1, steps_per_second=12, limit=2000, hold=2)
    windows = [opened(study, Player)]
    windows[0].says("Looking for another player")
    windows[0].is_accessible()
    windows.append(opened(study, Player, windows[0].address))
    for window in windows:
        window.says("Session 1 of 1")
        window.says("get the red agent to the blue landmark")
        assert window.page.locator("button:focus").text_content() == "I am ready"
    windows[1].is_accessible()
    for window in windows:
        window.page.keyboard.press("Enter")
    for window in windows:
        window.says("Time left:")
        assert window.page.get_by_role("img").get_attribute("aria-label")
        assert window.page.locator("canvas:focus").count() == 1
    for window, key in zip(windows, ("w", "ArrowUp"), strict=True):
        window.page.keyboard.down(key)
    for window in windows:
        assert window.colours() > 5
    for window in windows:
        window.has_said("Both goals are reached!")
    for window in windows:
        window.says("Thank you!")
        assert window.page.locator("#code").text_content() == study.settings.codes["finished"]
        assert window.faults == []
    windows[0].leave()
    with study.store() as store:
        (session,) = store.sessions()
    assert session["outcome"] == "goals"
    assert all(player["rtt_ms"] is None or player["rtt_ms"] > 0 for player in session["players"])


@needs_browser
def test_a_window_that_loses_its_connection_finds_back(opened: Opened, played: Any) -> None:
    study = played(
        0, partner="computer", hold=100, limit=100, rejoin_within=30, steps_per_second=12
    )
    window = opened(study, Beginner)
    window.says("Please do this")
    window.page.keyboard.down("w")
    window.says("1 of 5 done")
    window.is_accessible()
    window.page.keyboard.up("w")
    window.page.reload()
    window.says("1 of 5 done")  # the practice goes on where it was
    window.page.evaluate("() => window.sockets.at(-1).close()")
    window.has_said("The connection is lost")
    window.no_longer_says("The connection is lost")
    window.page.keyboard.press("q")
    window.says("2 of 5 done")
    other = window.context.new_page()
    other.goto(window.address)
    window.says("goes on in another window")
    other.get_by_text("2 of 5 done").wait_for(timeout=WAIT)
