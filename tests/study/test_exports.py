"""What people said comes out as tables that the package reads."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

pytest.importorskip("starlette", reason="the extra 'study' is not installed")

import phase_ppl as ppl
from phase_ppl.world.errors import OutputError, UnknownNameError
from phase_study import plan
from phase_study.experiments import LABELS, Likeness, Tags
from phase_study.settings import Settings
from phase_study.study import Study
from tests.study.studies import EVENTS, JUDGED, Person, edit, make_study, serving, table


@pytest.fixture(autouse=True, scope="module")
def _no_hurry() -> Iterator[None]:
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("phase_study.server.Site.allow", lambda *args: True)
        yield


def come(study: Study, *people: dict[str, Any]) -> list[str]:
    found = []
    with serving(study) as client:
        for given in people:
            person = Person(client)
            found.append(person.state()["participant"])
            person.finish(study, given)
    return found


def test_sliders_and_stops_are_checked_and_confidence_is_kept(tmp_path: Path) -> None:
    study = make_study(tmp_path / "study", answers="sliders", moments=[0.5])
    sliders = {"friendly": 20, "neutral": 60, "adversarial": 0}
    right = {**JUDGED, "relation": sliders}
    stopped = {**right, "moments": [{**right, "at": 0.5, "rt": 900}]}
    assert plan.checked(study.settings, "trial-1", stopped) == (stopped, None)
    assert plan.checked(study.settings, "trial-1", {**right, "moments": []})  # a shorter film
    for bad in (
        right,
        {**stopped, "relation": "neutral"},
        {**stopped, "relation": dict.fromkeys(sliders, 0)},
        {**stopped, "relation": {**sliders, "neutral": 101}},
        {**stopped, "relation": {"neutral": 60}},
        {**stopped, "moments": [{**right, "at": 0.6, "rt": 900}]},
        {**stopped, "moments": [{**right, "at": 0.5}]},
        {**stopped, "moments": stopped["moments"] * 2},
        {**stopped, "moments": [*stopped["moments"], {**right, "at": None, "rt": 900}]},
    ):
        with pytest.raises(plan.Unfit):
            plan.checked(study.settings, "trial-1", bad)
    sure = make_study(tmp_path / "sure", answers="confidence")
    come(sure, {**JUDGED, "confidence": 70})
    out = sure.export(tmp_path / "out")
    assert {row["confidence"] for row in table(out / "judgments.csv")} == {"70"}
    assert set(ppl.load_judgments(out / "judgments.csv").table["confidence"]) == {70.0}


@pytest.fixture(scope="module")
def judged(tmp_path_factory: pytest.TempPathFactory) -> Study:
    """Two finished, one excluded, one withdrawn, one failed the quiz, one left, one declined."""
    study = make_study(tmp_path_factory.mktemp("judged") / "study", tries=1)
    ids = come(study, JUDGED, {**JUDGED, "relation": "friendly"}, JUDGED, JUDGED)
    study.exclude(ids[2], "slept, said so")
    study.withdraw(ids[3])
    with serving(study) as client:
        Person(client).prepare(study, right=False)
        left = Person(client)
        left.prepare(study)
        left.answer("trial-1", JUDGED)
        Person(client).answer("consent", {"agree": False})
    return study


@pytest.fixture(scope="module")
def out(judged: Study, tmp_path_factory: pytest.TempPathFactory) -> Path:
    return judged.export(tmp_path_factory.mktemp("export") / "out")


def test_judgments_are_read_and_joined_to_the_events(out: Path) -> None:
    events = ppl.load_events(out / "events.json")
    found = ppl.load_judgments(out / "judgments.csv", events)
    assert len(found.table) == 6 * 3  # questions
    assert (found.table["response_time"] == 2.0).all()
    with_people = ppl.with_judgments(events, found)
    assert all(len(event.judgments["responses"]) == 2 for event in with_people)
    metrics = ppl.evaluate(events, "majority", judgments=found).metrics
    assert metrics["people"]["by_participant"]["n_participants"] == 2
    assert "scripted" not in metrics["people"]


def test_the_readme_counts_everybody(judged: Study, out: Path) -> None:
    text = (out / "README.md").read_text("utf-8")
    assert "rehearsal" not in text
    for line in ("entered | 7", "consented | 6", "declined | 1", "failed the quiz | 1",
                 "at it now | 1", "finished | 3", "withdrawn | 1", "excluded | 1",
                 "**in the tables** | 2"):  # fmt: skip
        assert f"| {line} |" in text, line
    counts = judged.status().counts
    assert (counts["entered"], counts["finished"], counts["excluded"]) == (7, 3, 1)
    for file in out.iterdir():
        assert f"### {file.name}" in text or file.name == "README.md"
    for name in ("judgments.csv", "participants.csv", "viewings.csv"):
        for column in table(out / name)[0]:
            assert f"| `{column}` |" in text


def test_who_is_included_can_be_chosen(judged: Study, tmp_path: Path) -> None:
    counts = {}
    for include in ((), ("excluded",), ("unfinished",), ("excluded", "unfinished")):
        out = judged.export(tmp_path / "out", include=include)
        counts[include] = len(table(out / "judgments.csv"))
    assert list(counts.values()) == [6, 9, 7, 10]
    with pytest.raises(UnknownNameError, match="people to include 'everybody'"):
        judged.export(tmp_path / "out", include=("everybody",))


def test_participants_are_told_with_their_fate(judged: Study, out: Path) -> None:
    people = table(out / "participants.csv")
    told = [[p[name] for p in people] for name in ("outcome", "included", "answers")]
    assert told == [
        ["finished"] * 3 + ["quiz_failed", "at it", "declined"],
        ["true"] * 2 + ["false"] * 4,
        ["3", "3", "3", "0", "1", "0"],
    ]
    assert [p["quiz_attempts"] for p in people] == ["1"] * 5 + ["0"]
    assert people[2]["reason"] == "slept, said so"
    assert people[0]["settings"] == judged.settings.sha256[:12]
    kept = out / f"study-{people[0]['settings']}.toml"
    assert kept.read_text("utf-8") == judged.settings.text


def test_exports_replace_exports_alone_and_tell_age_and_gender_only_where_asked(
    judged: Study, out: Path, tmp_path: Path
) -> None:
    assert "age 30.00 ± 0.00, 2 not said" in (out / "README.md").read_text("utf-8")
    assert not (out / "people.csv").exists()
    asked = judged.export(tmp_path / "asked", demographics=True)
    assert [row["age"] for row in table(asked / "people.csv")] == ["30", "30"]
    before = (out / "judgments.csv").read_bytes()
    assert (judged.export(out) / "judgments.csv").read_bytes() == before
    (tmp_path / "thesis.tex").touch()
    with pytest.raises(OutputError, match="other files"):
        judged.export(tmp_path)


def test_sliders_at_a_check_are_right_if_an_accepted_one_is_highest(tmp_path: Path) -> None:
    study = make_study(tmp_path / "study", answers="sliders")
    study = edit(study, "[checks]", '[checks]\ncompete = ["adversarial"]')
    tied = {"friendly": 50, "neutral": 0, "adversarial": 50}
    come(study, *({**JUDGED, "relation": one} for one in (tied, {**tied, "adversarial": 49})))
    people = table(study.export(tmp_path / "out") / "participants.csv")
    assert [p["checks_missed"] for p in people] == ["0", "1"]


def test_attention_checks_flag_and_are_no_judgments(tmp_path: Path) -> None:
    study = make_study(tmp_path / "study")
    # both answers are right of the first; one of them of the second, who has not attended
    right = f'compete = {{relation = ["adversarial"], goal_red = ["{JUDGED["goal_red"]}"]}}'
    study = edit(study, "[checks]", f"[checks]\n{right}")
    come(study, {**JUDGED, "relation": "adversarial"}, {**JUDGED, "relation": "friendly"})
    with study.store() as store:
        store._db.execute("UPDATE participant SET seen=consented + 150")
    out = study.export(tmp_path / "out")
    people = table(out / "participants.csv")
    assert [p["checks_missed"] for p in people] == ["0", "1"]
    assert [p["minutes"] for p in people] == ["2.5", "2.5"]
    assert {row["video"] for row in table(out / "judgments.csv")} == {"collaborate", "independent"}
    roles = [(row["video"] == "compete", row["role"]) for row in table(out / "viewings.csv")]
    assert set(roles) == {(True, "check"), (False, "main")}
    assert "| flagged | 1 |" in (out / "README.md").read_text("utf-8")
    strict = study.export(tmp_path / "strict", include=())
    assert len(table(strict / "judgments.csv")) == 2


def test_tags_are_of_the_list_and_are_read(tmp_path: Path) -> None:
    study = make_study(tmp_path / "study", "tagging", demographics=False)
    come(study, {"labels": ["helping", "chasing"]}, {"labels": ["helping"]})
    tags = Tags.load(study.export(tmp_path / "out") / "tags.csv")
    assert tags.viewers.to_dict() == dict.fromkeys(study.events, 2)
    assert set(tags.shares["helping"]) == {1.0}
    assert set(tags.shares["chasing"]) == {0.5}
    orders = set()
    with serving(study) as client:
        for _ in range(4):
            person = Person(client)
            person.prepare(study)
            asked = [page["questions"][0]["options"] for page in person.state()["pages"]]
            assert asked[0] == asked[1], "the same order on all pages of a person"
            orders.add(tuple(label for label, _ in asked[0]))
            for bad in ([], ["helping", "helping"], ["flying"], "helping", [["helping"]]):
                assert person.answer("trial-1", {"labels": bad}).status_code == 400
    assert len(orders) > 1
    assert {frozenset(order) for order in orders} == {frozenset(LABELS)}


def test_likeness_has_groups_and_pairs(tmp_path: Path) -> None:
    study = make_study(tmp_path / "study", "likeness", demographics=False)
    assert list(study.events)[3:] == [f"{event}-generated" for event in EVENTS]
    come(study, *({**JUDGED, "likeness": rating} for rating in (3, 4, 5, 4)))
    out = study.export(tmp_path / "out")
    likeness = Likeness.load(out / "likeness.csv")
    assert likeness.groups == ("played", "generated")
    assert likeness.table["group"].value_counts().to_dict() == {"played": 6, "generated": 6}
    assert len(ppl.load_judgments(out / "judgments.csv").table) == 12 * 3
    told = table(out / "likeness.csv")
    pairs = {(row["pair"], row["video"].removesuffix("-generated")) for row in told}
    assert len(pairs) == 3, "a played event and its counterpart have the same number"


def test_ratings_are_one_to_five() -> None:
    settings = Settings.parse('kind = "likeness"')
    assert plan.checked(settings, "trial-1", {**JUDGED, "likeness": 5}) is not None
    for rating in (0, 6, "4", True, None, 3.5, 3.0):
        with pytest.raises(plan.Unfit, match="likeness"):
            plan.checked(settings, "trial-1", {**JUDGED, "likeness": rating})
