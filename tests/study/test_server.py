"""The server of a study: the way of a participant, and everything that is refused."""

from __future__ import annotations

import dataclasses
import re
import sqlite3
from collections.abc import Iterator
from typing import Any

import pytest

pytest.importorskip("starlette", reason="the extra 'study' is not installed")
from starlette.testclient import TestClient

from phase_study import server, store
from phase_study.server import MOST_BODY
from phase_study.study import Study
from tests.study.studies import HOST, JUDGED, Person, make_study, quiz, rows, serving


@pytest.fixture(scope="module")
def study(tmp_path_factory: pytest.TempPathFactory) -> Study:
    limits = {"entries_per_minute": 1000, "most_entries": 1000}
    return make_study(tmp_path_factory.mktemp("made") / "study", raters=200, trials=2, **limits)


@pytest.fixture(scope="module")
def client(study: Study) -> Iterator[TestClient]:
    with serving(study) as found:
        yield found


def with_settings(study: Study, **given: Any) -> Study:
    changed = Study(study.folder)
    changed.settings = dataclasses.replace(study.settings, **given)
    return changed


@pytest.fixture
def person(client: TestClient) -> Person:
    return Person(client)


@pytest.fixture
def prepared(study: Study, person: Person) -> Person:
    """Somebody before the first animation."""
    person.prepare(study)
    return person


@pytest.fixture(autouse=True)
def _no_hurry(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("phase_study.server.Site.allow", lambda *args: True)


def pages(person: Person) -> list[tuple[str, int]]:
    return [(page["page"], page["attempt"]) for page in person.state()["pages"]]


def newcomer(client: TestClient) -> Person:
    return Person(client, enter=False)


def test_a_wrong_quiz_leads_back_and_the_last_one_ends_it(study: Study, person: Person) -> None:
    person.prepare(study, right=False)
    assert pages(person) == [("tutorial", 2), ("quiz", 2)]
    tutorial, asked = person.state()["pages"]
    assert "not right" in tutorial["html"]
    assert "answer" not in asked, "the right ones are not told"
    person.answer("tutorial", {"views": []}, 2)
    person.answer("quiz", quiz(study, right=False), 2)
    state = person.state()
    assert (state["status"], state["outcome"]) == ("over", "quiz_failed")
    assert state["code"] == study.settings.codes["quiz_failed"] != study.settings.codes["finished"]
    assert person.state() == state
    assert person.answer("trial-1", JUDGED).status_code == 409


def test_nothing_comes_before_consent_or_without_it(person: Person) -> None:
    for page in ("device", "tutorial", "quiz", "trial-1", "person"):
        assert person.answer(page, {}).status_code == 409
    agrees = {"page": "consent", "attempt": 1, "answers": {"agree": True}}
    somebody_else = Person(person.client).state()["participant"]
    for more in ({"rt_ms": -1}, {"plays": "3"}, {"shown_ms": 1e300}, {"attempt": "1"},
                 {"attempt": 2}, {"page": 5}, {"participant": somebody_else}):  # fmt: skip
        assert person.post("/api/answer", {**agrees, **more}).status_code in (400, 409), more
    person.answer("consent", {"agree": False})
    assert person.state()["outcome"] == "declined"
    assert person.answer("device", {}).status_code == 409


def test_who_comes_back_late_is_told_so(prepared: Person, monkeypatch: pytest.MonkeyPatch) -> None:
    now = server.time.time()
    monkeypatch.setattr(server.time, "time", lambda: now + 60 * 121)
    # what was given before the network was lost is still kept
    assert prepared.answer("trial-1", JUDGED).json()["saved"]
    assert prepared.state()["outcome"] == "expired"


def test_what_a_crash_left_undone_is_done_later(
    study: Study, person: Person, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("phase_study.plan.outcome", lambda *args: None)
    person.finish(study)
    assert person.state()["status"] == "open"
    monkeypatch.undo()
    assert person.state()["outcome"] == "finished"


def test_who_began_may_finish_in_a_closed_study(study: Study, prepared: Person) -> None:
    with serving(with_settings(study, open=False)) as client:
        assert newcomer(client).state()["outcome"] == "closed"
        assert newcomer(client).enter().json()["outcome"] == "closed"
        prepared.client = client
        assert prepared.answer("trial-1", JUDGED).json()["saved"]


def test_a_platforms_id_lets_in_once_and_its_address_holds_the_code(study: Study) -> None:
    url = "https://platform.example/done?cc={code}"
    changed = with_settings(
        study, refuse_repeats="PROLIFIC_PID", return_url=url, demographics=False
    )
    with serving(changed) as client:
        assert newcomer(client).state()["repeats"] == "PROLIFIC_PID"
        people = [newcomer(client) for _ in range(3)]
        ids = ("5f0c-secret", "5f0c-secret", "5f0c-other")
        found = [one.enter(person=id).json() for one, id in zip(people, ids, strict=True)]
        people[0].finish(changed)
        back = people[0].state()["return_url"]
    assert found[0] == found[2] == {"entered": True}
    assert found[1]["outcome"] == "repeated"
    assert back.endswith(f"cc={changed.settings.codes['finished']}")
    everything = b"".join(file.read_bytes() for file in study.folder.glob("study.db*"))
    assert b"5f0c-secret" not in everything


def test_other_origins_are_refused(person: Person) -> None:
    other = "http://evil.example", "null", "", "http://localhost.evil.example", "https://"
    person.client.cookies.clear()
    for path in ("/api/enter", "/api/answer", "/api/note"):
        for origin in ({}, *({"Origin": name} for name in other)):
            headers = {"Cookie": person.cookie, **origin}
            assert person.client.post(path, json={}, headers=headers).status_code == 403, origin


def test_other_hosts_are_refused_and_the_page_asks_nobody_else(client: TestClient) -> None:
    for path in ("/", "/static/study.js", "/static/page.js", "/static/study.css"):
        assert client.get(path, headers={"Host": "evil.example"}).status_code == 400
        text = client.get(path, headers={"Host": "localhost:8000"}).text
        assert not re.search(r"https?://|//[a-z0-9.-]+\.[a-z]{2,}", text)
    assert "sourceMappingURL" not in client.get("/static/vendor/jspsych.js").text


def test_the_cookie_is_for_this_page_alone(study: Study, client: TestClient) -> None:
    with serving(study, "https://study.example") as by_tls:
        for at, secure in ((client, False), (by_tls, True)):
            at.cookies.clear()
            given = at.post("/api/enter", json={}, headers={"Origin": HOST})
            cookie = given.headers["set-cookie"]
            assert "HttpOnly" in cookie
            assert "SameSite=strict" in cookie
            assert ("Secure" in cookie) == secure
    token = cookie.partition("=")[2].partition(";")[0]
    assert len(token) >= 32, "192 bits"
    kept = str(rows(study, "SELECT token FROM participant"))
    assert token not in kept
    assert store.hashed(token) in kept


def test_a_stranger_gets_nothing_and_names_say_nothing(study: Study, prepared: Person) -> None:
    state = prepared.get("/api/state")
    film = state.json()["pages"][0]["video"]
    stranger = newcomer(prepared.client)
    *same, last = prepared.cookie
    stranger.cookie = "".join((*same, "y" if last == "x" else "x"))
    for path in (film, "/video/x.mp4"):
        assert stranger.get(path).status_code == 401
    for path in ("/api/answer", "/api/note"):
        assert stranger.post(path, {}).status_code == 401
    assert Person(prepared.client).get(film).status_code == 404, "somebody else's film"
    seen = state.text + prepared.get("/").text + str(prepared.get(film).headers)
    for event in study.events:
        assert event not in seen
    for file in (study.folder / "videos").iterdir():
        assert re.fullmatch(r"[0-9a-f]{24}\.mp4", file.name)
        assert file.name not in seen


def test_files_beside_the_pages_are_not_served(person: Person) -> None:
    for path in ("/video/..%2f..%2fstudy.db.mp4", "/static/../study.toml",
                 "/static/..%2f..%2fstore.py", "/clip/..%2fstudy.mp4", "/study.db", "/events.json",
                 "/clip/nothing.mp4"):  # fmt: skip
        assert person.get(path).status_code == 404, path


def test_every_answer_carries_the_headers(prepared: Person) -> None:
    film = prepared.state()["pages"][0]["video"]
    for path in ("/", "/api/state", "/static/study.js", "/static/vendor/jspsych.js", film, "/none"):
        headers = prepared.get(path).headers
        policy = headers["content-security-policy"]
        assert "default-src 'self'" in policy
        assert "script-src" not in policy, "scripts from here only, none inline"
        assert headers["x-content-type-options"] == "nosniff"
        assert headers["referrer-policy"] == "no-referrer"
        assert headers["cache-control"] == "no-store"
        assert "server" not in headers


def upload(person: Person, content: Any, kind: str = "application/json") -> int:
    headers = person.headers(**{"Content-Type": kind})
    return int(person.client.post("/api/answer", content=content, headers=headers).status_code)


def test_large_bodies_and_what_is_no_json_object_are_refused(person: Person) -> None:
    assert person.answer("consent", {"agree": "x" * MOST_BODY}).status_code == 413
    assert upload(person, (b"x" * 1000 for _ in range(100))) == 413, "no length is told"
    for body in (b"", b"{", b"[1]", b"\xff", b"nul", b"[" * 5000, b'"text"'):
        assert upload(person, body) == 400
    assert upload(person, b"{}", "text/plain") == 415


def test_other_answers_than_those_asked_for_are_refused(study: Study, person: Person) -> None:
    def refuses(page: str, *given: dict[str, Any]) -> None:
        for answers in given:
            assert person.answer(page, answers).status_code == 400, answers

    refuses("consent", {"agree": 1}, {})
    person.answer("consent", {"agree": True})
    refuses("device", {"screen": 3})
    refuses("tutorial", {"views": "all"}, {"views": [1] * 501})
    refuses("quiz", {"question_1": "x"})
    person.prepare(study)
    refuses("trial-1", {}, {"relation": "neutral"}, {**JUDGED, "more": 1})
    refuses("trial-1", *({**JUDGED, "relation": bad} for bad in ("hostile", None, ["neutral"])))
    refuses("trial-1", {**JUDGED, "goal_red": "get to red agent"}, {**JUDGED, "goal_green": "=1+1"})
    assert pages(person)[0] == ("trial-1", 1)
    for page in ("trial-1", "trial-2"):
        person.answer(page, JUDGED)
    refuses("person", *({"age": age, "gender": ""} for age in (17, 121, 0, "30", 30.5, True)))
    refuses("person", *({"age": 40, "gender": gender} for gender in ("robot", True, ["other"])))
    assert person.answer("person", {"age": 40, "gender": "other"}).json()["saved"]


def test_answers_come_five_a_second(
    person: Person, monkeypatch: pytest.MonkeyPatch, request: pytest.FixtureRequest
) -> None:
    monkeypatch.undo()  # limits of rates hold
    request.getfixturevalue("in_a_moment")
    replies = [person.answer("consent", {"agree": True}).status_code for _ in range(8)]
    assert replies == [200] * 5 + [429] * 3


def test_notes_are_of_few_kinds(study: Study, person: Person) -> None:
    assert person.post("/api/note", {"what": "hidden", "page": "x", "detail": 3}).status_code == 200
    for bad in ({"what": "my name"}, {"what": "blur", "detail": "text"}, {"what": ["blur"]},
                {"what": "blur", "page": "x" * 50}):  # fmt: skip
        assert person.post("/api/note", bad).status_code == 400
    who = person.state()["participant"]
    found = rows(study, f"SELECT what, page, detail FROM note WHERE participant='{who}'")
    assert found == [{"what": "hidden", "page": "x", "detail": 3.0}]


def test_a_full_disk_is_told_and_loses_nothing(
    person: Person, monkeypatch: pytest.MonkeyPatch, capfd: Any
) -> None:
    who = person.state()["participant"]

    def full(*args: object, **more: object) -> None:
        raise sqlite3.OperationalError("database or disk is full")

    with monkeypatch.context() as patch:
        patch.setattr(store.Store, "answer", full)
        reply = person.answer("consent", {"agree": True})
    assert reply.status_code == 503
    assert "cannot be saved" in reply.json()["error"]
    told = capfd.readouterr().err
    assert "disk is full" in told
    assert who not in told
    assert person.answer("consent", {"agree": True}).json()["new"]


def test_texts_are_escaped(study: Study) -> None:
    bad = "<script>alert(1)</script> ![x](http://evil.example/x.png) [y](javascript:alert(1))"
    with serving(with_settings(study, texts={**study.settings.texts, "consent": bad})) as client:
        page = Person(client).state()["pages"][0]
    assert "alert" in page["html"]
    assert "<script" not in page["html"]
    assert "<img" not in page["html"]
    assert 'href="javascript' not in page["html"]
