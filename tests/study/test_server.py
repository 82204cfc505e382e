"""The server of a study: the way of a participant, and everything that is refused."""

from __future__ import annotations

import re
import sqlite3
from collections.abc import Iterator
from typing import Any

import pytest

pytest.importorskip("starlette", reason="the extra 'study' is not installed")
from starlette.testclient import TestClient

from phase_ppl.study import server, store
from phase_ppl.study.study import Study
from phase_ppl.study.web import MOST_BODY
from tests.study.studies import HOST, JUDGED, Person, change, make_study, quiz


@pytest.fixture(scope="module")
def made(tmp_path_factory: pytest.TempPathFactory) -> Study:
    limits = {"entries_per_minute": 1000, "most_entries": 1000}
    return make_study(tmp_path_factory.mktemp("made") / "study", raters=200, trials=2, **limits)


@pytest.fixture
def study(made: Study) -> Iterator[Study]:
    """The study with its settings as they were; people who came before stay."""
    text = (made.folder / "study.toml").read_text("utf-8")
    yield made
    (made.folder / "study.toml").write_text(text, "utf-8")


@pytest.fixture
def client(study: Study) -> Iterator[TestClient]:
    with TestClient(study.app(), base_url=HOST) as found:
        yield found


@pytest.fixture(autouse=True)
def _no_hurry(monkeypatch: pytest.MonkeyPatch, request: pytest.FixtureRequest) -> None:
    if "hurry" not in request.fixturenames:
        monkeypatch.setattr("phase_ppl.study.web.Site.allow", lambda *args: True)


@pytest.fixture
def hurry() -> None:
    """Limits of rates hold."""


def rows(study: Study, query: str) -> list[dict[str, Any]]:
    with study.store() as opened:
        return opened.rows(query)


def test_from_consent_to_the_code(study: Study, client: TestClient) -> None:
    person = Person(client, enter=False)
    assert person.state() == {"status": "new", "repeats": ""}
    assert person.enter().json() == {"entered": True}
    assert [page["page"] for page in person.state()["pages"]] == ["consent"]
    person.answer("consent", {"agree": True})
    assert [page["page"] for page in person.state()["pages"]] == ["device", "tutorial", "quiz"]
    person.prepare(study)
    state = person.state()
    assert [page["page"] for page in state["pages"]] == ["trial-1", "trial-2", "person"]
    assert [page["heading"] for page in state["pages"][:2]] == [
        "Animation 1 of 2",
        "Animation 2 of 2",
    ]
    film = person.get(state["pages"][0]["video"])
    assert film.headers["content-type"] == "video/mp4"
    assert film.content[4:8] == b"ftyp"
    assert person.answer("trial-1", JUDGED).json()["next"] == "trial-2-1"
    assert [page["page"] for page in person.state()["pages"]] == ["trial-2", "person"]
    person.answer("trial-2", JUDGED)
    assert person.answer("person", {"age": None, "gender": ""}).json()["next"] is None
    state = person.state()
    assert (state["status"], state["outcome"]) == ("over", "finished")
    assert state["code"] == study.settings.codes["finished"]
    found = rows(study, "SELECT id FROM participant WHERE outcome='finished'")
    assert found[-1]["id"] in state["html"]


def test_a_wrong_quiz_leads_back_to_the_introduction(study: Study, client: TestClient) -> None:
    person = Person(client)
    person.prepare(study, right=False)
    state = person.state()
    assert [(p["page"], p["attempt"]) for p in state["pages"]] == [("tutorial", 2), ("quiz", 2)]
    assert "not right" in state["pages"][0]["html"]
    assert "answer" not in state["pages"][1], "the right ones are not told"
    person.answer("tutorial", {"views": []}, 2)
    person.answer("quiz", quiz(study), 2)
    assert person.state()["pages"][0]["page"] == "trial-1"


def test_the_last_wrong_quiz_ends_it_with_a_code_of_its_own(
    study: Study, client: TestClient
) -> None:
    person = Person(client)
    person.prepare(study, right=False)
    person.answer("tutorial", {"views": []}, 2)
    person.answer("quiz", quiz(study, right=False), 2)
    state = person.state()
    assert (state["status"], state["outcome"]) == ("over", "quiz_failed")
    assert state["code"] == study.settings.codes["quiz_failed"] != study.settings.codes["finished"]
    who = person.state()
    assert who == state
    assert person.answer("trial-1", JUDGED).status_code == 409


def test_who_does_not_agree_sees_nothing_more(study: Study, client: TestClient) -> None:
    person = Person(client)
    person.answer("consent", {"agree": False})
    assert person.state()["outcome"] == "declined"
    assert person.answer("device", {}).status_code == 409


def test_nothing_comes_before_consent(client: TestClient) -> None:
    person = Person(client)
    for page in ("device", "tutorial", "quiz", "trial-1", "person"):
        assert person.answer(page, {}).status_code == 409


def test_repeated_uploads_and_second_tabs_change_nothing(study: Study, client: TestClient) -> None:
    person = Person(client)
    person.prepare(study)
    assert person.answer("trial-1", JUDGED).json()["new"]
    again = person.answer("trial-1", {**JUDGED, "relation": "friendly"}).json()
    assert again == {"saved": True, "new": False, "next": "trial-2-1"}
    who = person.state()["participant"]
    kept = rows(study, f"SELECT answers FROM response WHERE participant='{who}' AND page='trial-1'")
    assert len(kept) == 1
    assert "neutral" in kept[0]["answers"]


def test_who_comes_back_too_late_is_told_so(
    study: Study, client: TestClient, monkeypatch: pytest.MonkeyPatch
) -> None:
    person = Person(client)
    person.prepare(study)
    now = server.time.time()
    monkeypatch.setattr(server.time, "time", lambda: now + 60 * 121)
    # what was given before the network was lost is still kept
    assert person.answer("trial-1", JUDGED).json()["saved"]
    assert person.state()["outcome"] == "expired"


@pytest.mark.parametrize("after", ["quiz", "person"])
def test_what_a_crash_left_undone_is_done_later(
    study: Study, client: TestClient, monkeypatch: pytest.MonkeyPatch, after: str
) -> None:
    person = Person(client)
    monkeypatch.setattr("phase_ppl.study.plan.outcome", lambda *args: None)
    person.prepare(study)
    if after == "quiz":
        assert person.state()["pages"][0]["page"] == "trial-1"
        return
    for page in person.state()["pages"]:
        is_person = page["page"] == "person"
        person.answer(page["page"], {"age": 20, "gender": ""} if is_person else JUDGED)
    monkeypatch.undo()
    assert person.state()["outcome"] == "finished"


def test_a_closed_study_lets_nobody_in_but_who_began_may_finish(study: Study) -> None:
    with TestClient(study.app(), base_url=HOST) as client:
        person = Person(client)
        person.prepare(study)
    with TestClient(change(study, open=False).app(), base_url=HOST) as client:
        assert Person(client, enter=False).state()["outcome"] == "closed"
        assert Person(client, enter=False).enter().json()["outcome"] == "closed"
        person.client = client
        assert person.answer("trial-1", JUDGED).json()["saved"]


def test_a_full_study_says_so(study: Study) -> None:
    with TestClient(change(study, most_entries=1).app(), base_url=HOST) as client:
        Person(client)
        found = Person(client, enter=False).enter().json()
    assert (found["status"], found["outcome"], found["code"]) == ("over", "full", "")


def test_a_platforms_id_lets_in_once(study: Study) -> None:
    changed = change(study, refuse_repeats="PROLIFIC_PID")
    with TestClient(changed.app(), base_url=HOST) as client:
        assert Person(client, enter=False).state()["repeats"] == "PROLIFIC_PID"
        found = [Person(client, enter=False).enter(person="5f0c-secret").json() for _ in range(2)]
    assert found[0] == {"entered": True}
    assert found[1]["outcome"] == "repeated"
    everything = b"".join(file.read_bytes() for file in study.folder.glob("study.db*"))
    assert b"5f0c-secret" not in everything


def test_the_address_to_return_to_holds_the_code(study: Study) -> None:
    url = "https://platform.example/done?cc={code}"
    changed = change(study, return_url=url, demographics=False)
    with TestClient(changed.app(), base_url=HOST) as client:
        person = Person(client)
        person.finish(changed)
        assert person.state()["return_url"].endswith(f"cc={changed.settings.codes['finished']}")


# --- what is refused ------------------------------------------------------------------------------


@pytest.mark.parametrize(
    "origin", ["http://evil.example", "null", "", "http://localhost.evil.example", "https://"]
)
@pytest.mark.parametrize("path", ["/api/enter", "/api/answer", "/api/note"])
def test_other_origins_are_refused(client: TestClient, path: str, origin: str) -> None:
    person = Person(client)
    reply = client.post(path, json={}, headers={"Origin": origin, "Cookie": person.cookie})
    assert reply.status_code == 403
    client.cookies.clear()
    assert client.post(path, json={}).status_code == 403, "without any origin"


def test_other_hosts_are_refused(client: TestClient) -> None:
    for path in ("/", "/api/state", "/static/study.js"):
        assert client.get(path, headers={"Host": "evil.example"}).status_code == 400
        assert client.get(path, headers={"Host": "localhost:8000"}).status_code == 200


def test_the_cookie_is_for_this_page_alone(study: Study) -> None:
    for url, secure in (("", False), ("https://study.example", True)):
        with TestClient(study.app(url), base_url=HOST) as client:
            given = client.post("/api/enter", json={}, headers={"Origin": HOST})
        cookie = given.headers["set-cookie"]
        assert "HttpOnly" in cookie
        assert "SameSite=strict" in cookie
        assert ("Secure" in cookie) == secure
        token = cookie.partition("=")[2].partition(";")[0]
        assert len(token) >= 32, "192 bits"
        kept = rows(study, "SELECT token FROM participant")
        assert token not in str(kept)
        assert store.hashed(token) in str(kept)


def test_a_stranger_gets_nothing(study: Study, client: TestClient) -> None:
    person = Person(client)
    person.prepare(study)
    film = person.state()["pages"][0]["video"]
    stranger = Person(client, enter=False)
    stranger.cookie = person.cookie[:-1] + "x"
    for path in (film, "/video/x.mp4"):
        assert stranger.get(path).status_code == 401
    for path in ("/api/answer", "/api/note"):
        assert stranger.post(path, {}).status_code == 401
    assert Person(client).get(film).status_code == 404, "somebody else's film"


def test_names_say_nothing(study: Study, client: TestClient) -> None:
    person = Person(client)
    person.prepare(study)
    state = person.get("/api/state")
    film = person.get(state.json()["pages"][0]["video"])
    seen = state.text + person.get("/").text + str(film.headers)
    for event in study.events:
        assert event not in seen
    for file in (study.folder / "videos").iterdir():
        assert re.fullmatch(r"[0-9a-f]{24}\.mp4", file.name)
        assert file.name not in seen


@pytest.mark.parametrize("path", ["/video/..%2f..%2fstudy.db.mp4", "/static/../study.toml",
                                  "/static/..%2f..%2fstore.py", "/clip/..%2fstudy.mp4",
                                  "/study.db", "/events.json", "/clip/nothing.mp4"])  # fmt: skip
def test_files_beside_the_pages_are_not_served(client: TestClient, path: str) -> None:
    assert Person(client).get(path).status_code == 404


def test_every_answer_carries_the_headers(study: Study, client: TestClient) -> None:
    person = Person(client)
    person.prepare(study)
    film = person.state()["pages"][0]["video"]
    for path in ("/", "/api/state", "/static/study.js", "/static/vendor/jspsych.js", film, "/none"):
        headers = person.get(path).headers
        policy = headers["content-security-policy"]
        assert "default-src 'self'" in policy
        assert "script-src" not in policy, "scripts from here only, none inline"
        assert headers["x-content-type-options"] == "nosniff"
        assert headers["referrer-policy"] == "no-referrer"
        assert headers["cache-control"] == "no-store"
        assert "server" not in headers


def test_the_page_asks_nobody_else(client: TestClient) -> None:
    for path in ("/", "/static/study.js", "/static/page.js", "/static/study.css"):
        assert not re.search(r"https?://|//[a-z0-9.-]+\.[a-z]{2,}", client.get(path).text)
    assert "url(" not in client.get("/static/vendor/jspsych.css").text
    assert "sourceMappingURL" not in client.get("/static/vendor/jspsych.js").text


def test_large_bodies_are_refused(client: TestClient) -> None:
    person = Person(client)
    assert person.answer("consent", {"agree": "x" * MOST_BODY}).status_code == 413
    chunks = (b"x" * 1000 for _ in range(100))
    headers = person.headers(**{"Content-Type": "application/json"})
    reply = client.post("/api/answer", content=chunks, headers=headers)
    assert reply.status_code == 413, "also where no length is told"


@pytest.mark.parametrize("body", [b"", b"{", b"[1]", b"\xff", b"nul", b"[" * 5000, b'"text"'])
def test_what_is_no_json_object_is_refused(client: TestClient, body: bytes) -> None:
    person = Person(client)
    headers = person.headers(**{"Content-Type": "application/json"})
    assert client.post("/api/answer", content=body, headers=headers).status_code == 400
    headers["Content-Type"] = "text/plain"
    assert client.post("/api/answer", content=b"{}", headers=headers).status_code == 415


BAD: list[dict[str, Any]] = [
    {},
    {"relation": "neutral"},
    {**JUDGED, "more": 1},
    {**JUDGED, "relation": "hostile"},
    {**JUDGED, "relation": None},
    {**JUDGED, "relation": ["neutral"]},
    {**JUDGED, "goal_red": "get to red agent"},
    {**JUDGED, "goal_green": "=1+1"},
]


@pytest.mark.parametrize("answers", BAD)
def test_other_answers_than_those_asked_for_are_refused(
    study: Study, client: TestClient, answers: dict[str, Any]
) -> None:
    person = Person(client)
    person.prepare(study)
    assert person.answer("trial-1", answers).status_code == 400
    assert person.state()["pages"][0]["page"] == "trial-1"


@pytest.mark.parametrize(
    ("page", "answers"),
    [
        ("consent", {"agree": 1}),
        ("consent", {}),
        ("device", {"screen": 3}),
        ("tutorial", {"views": "all"}),
        ("tutorial", {"views": [1] * 501}),
        ("quiz", {"question_1": "x"}),
    ],
)
def test_nor_before_the_trials(
    study: Study, client: TestClient, page: str, answers: dict[str, Any]
) -> None:
    person = Person(client)
    if page != "consent":
        person.answer("consent", {"agree": True})
    assert person.answer(page, answers).status_code == 400


@pytest.mark.parametrize("age", [17, 121, "30", 30.5, True])
def test_ages_are_checked(study: Study, client: TestClient, age: object) -> None:
    person = Person(client)
    person.prepare(study)
    for page in ("trial-1", "trial-2"):
        person.answer(page, JUDGED)
    assert person.answer("person", {"age": age, "gender": ""}).status_code == 400
    assert person.answer("person", {"age": 40, "gender": "robot"}).status_code == 400
    assert person.answer("person", {"age": 40, "gender": "other"}).json()["saved"]


@pytest.mark.parametrize("more", [{"rt_ms": -1}, {"plays": "3"}, {"shown_ms": 1e300},
                                  {"attempt": "1"}, {"attempt": 2}, {"page": 5}])  # fmt: skip
def test_times_pages_and_attempts_are_checked(client: TestClient, more: dict[str, Any]) -> None:
    person = Person(client)
    body = {"page": "consent", "attempt": 1, "answers": {"agree": True}, **more}
    assert person.post("/api/answer", body).status_code in (400, 409)


def test_an_answer_of_somebody_else_is_refused(client: TestClient) -> None:
    one, other = Person(client), Person(client)
    who = one.state()["participant"]
    reply = other.answer("consent", {"agree": True}, participant=who)
    assert reply.status_code == 409


def test_answers_come_five_a_second(client: TestClient, hurry: None) -> None:
    person = Person(client)
    replies = [person.answer("consent", {"agree": True}).status_code for _ in range(8)]
    assert replies[:5] == [200] * 5
    assert 429 in replies


def test_notes_are_of_few_kinds(study: Study, client: TestClient) -> None:
    person = Person(client)
    assert person.post("/api/note", {"what": "hidden", "page": "x", "detail": 3}).status_code == 200
    for bad in ({"what": "my name"}, {"what": "blur", "detail": "text"}, {"what": ["blur"]},
                {"what": "blur", "page": "x" * 50}):  # fmt: skip
        assert person.post("/api/note", bad).status_code == 400
    who = person.state()["participant"]
    found = rows(study, f"SELECT what, page, detail FROM note WHERE participant='{who}'")
    assert found == [{"what": "hidden", "page": "x", "detail": 3.0}]


def test_a_full_disk_is_told_and_loses_nothing(
    study: Study, client: TestClient, monkeypatch: pytest.MonkeyPatch, capfd: Any
) -> None:
    person = Person(client)
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
    text = (study.folder / "study.toml").read_text("utf-8")
    bad = "<script>alert(1)</script> ![x](http://evil.example/x.png) [y](javascript:alert(1))"
    text = text.replace("You are invited", f"{bad} You are invited")
    (study.folder / "study.toml").write_text(text, "utf-8")
    with TestClient(Study(study.folder).app(), base_url=HOST) as client:
        page = Person(client).state()["pages"][0]
    assert "<script" not in page["html"]
    assert "<img" not in page["html"]
    assert 'href="javascript' not in page["html"]
