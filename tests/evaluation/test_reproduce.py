"""The paper's numbers beside ours: verdicts, what is missing, and going on."""

from __future__ import annotations

import dataclasses
import functools
import json
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pandas as pd
import pytest

import phase_ppl as ppl
from phase_ppl.cli import main
from phase_ppl.evaluation import reproduce as module
from phase_ppl.evaluation.reproduce import (
    SIMPLE,
    STEERED,
    Asked,
    Printed,
    models_of,
    verdict,
)
from phase_ppl.world.errors import (
    InvalidEventError,
    InvalidSettingError,
    OutputError,
    UnknownNameError,
)
from phase_ppl.world.hypothesis import SCENARIOS
from tests.evaluation.judged import COLLABORATIVE, COMPETING, INDEPENDENT, OPPOSING, make_event
from tests.models.vlm.answers import text
from tests.models.walks import eight, make_set

VOTES = {COLLABORATIVE: (9, 1, 0), INDEPENDENT: (1, 8, 1), COMPETING: (0, 2, 8),
         OPPOSING: (1, 0, 9)}  # fmt: skip


def ours(value: float, low: float | None = None, high: float | None = None) -> dict[str, Any]:
    return {"value": value, "ci_low": low, "ci_high": high}


def test_verdicts() -> None:
    interval, bound = (0.59, 0.41, 0.77), (0.6, None, None, True)
    for printed, found, wanted in (
        (interval, ours(0.8, 0.5, 1.0), "inside"),  # only the paper's in ours
        (interval, ours(0.7, 0.65, 0.75), "inside"),  # ours in the paper's
        (interval, ours(0.9, 0.8, 1.0), "outside"),
        ((0.78,), ours(0.84, 0.75, 0.92), "inside"),
        ((0.78,), ours(0.84, 0.80, 0.92), "outside"),
        ((18.0,), ours(18.0), "inside"),
        ((18.0,), ours(17.0), "outside"),
        (bound, ours(0.7, 0.55, 0.8), "inside"),  # a bound that only ours holds
        (bound, ours(0.7, 0.65, 0.8), "outside"),
        (bound, ours(0.2), "inside"),
    ):
        given = Printed("here", "what", SIMPLE, "goal_accuracy", *printed)
        assert verdict(given, found) == wanted, (printed, found)


def test_a_model_is_like_people_where_nothing_shows_that_they_differ() -> None:
    given = {("goal", "ours"): (0.5, 0.04, 0.05, 0.2), ("relation", "ours"): (0.01, 0.5, 0.5, None),
             ("goal", "theirs"): (0.01, 0.01, 0.01, 0.01)}  # fmt: skip
    rows = [
        {"model": model, "measure": f"{kind}_accuracy", "scenario": scenario, "p": p}
        for (kind, model), all_p in given.items()
        for scenario, p in [*zip(SCENARIOS, all_p, strict=True), (None, 0.9)]
    ]
    comparison: Any = SimpleNamespace(equivalence=rows)
    assert module._like_people(comparison, "ours") == {"goal": ours(3.0)}
    assert module._like_people(comparison, "theirs") == {"goal": ours(0.0)}


def test_profiles_ask_more() -> None:
    quick, paper = (models_of(profile) for profile in ("quick", "paper"))
    assert set(quick) < set(paper)
    assert quick["simple_as_printed"].options["planner"] == "as_printed_fast"
    assert paper["simple_as_printed"].options == {"preset": "as_printed"}
    with pytest.raises(UnknownNameError, match="'quick'"):
        models_of("quik")


@pytest.fixture
def models(monkeypatch: pytest.MonkeyPatch, unpainted: None) -> None:
    """Have two models that take no time, and one that is not installed."""
    asked = {
        "simple": Asked("last_frame", whose=SIMPLE),
        "majority": Asked("majority"),
        "absent": Asked("absent", whose="SocialGNN"),
    }
    info, said = module.model_info, "torch is not installed"
    absent = dataclasses.replace(info("majority"), needs=("torch",))
    for name, stands_in in {
        "models_of": lambda profile: dict(asked),
        "model_info": lambda name: absent if name == "absent" else info(name),
        "not_installed": lambda needs, _: said if needs else None,
        "compare_models": functools.partial(module.compare_models, resamples=200),
    }.items():
        monkeypatch.setattr(module, name, stands_in)


@pytest.fixture
def cheap(models: None, monkeypatch: pytest.MonkeyPatch) -> None:
    """Have no pages either, which take most of the time."""
    monkeypatch.setattr("phase_ppl.evaluation.report.report", lambda *given, **more: None)


@pytest.fixture(scope="module")
def videos(tmp_path_factory: pytest.TempPathFactory) -> Path:
    file = tmp_path_factory.mktemp("videos") / "videos.json"
    events = [make_event(f"{n}-{i}", goals, votes)
              for n, (goals, votes) in enumerate(VOTES.items()) for i in range(3)]  # fmt: skip
    ppl.save_events(events, file)
    return file


def cells(made: ppl.Reproduction) -> dict[tuple[str, str], Any]:
    return {(one.label, one.printed.what): one for one in made.cells}


def test_real_videos_give_cells_a_table_and_a_page(
    models: None, videos: Path, tmp_path: Path
) -> None:
    out, said = tmp_path / "out", list[str]()
    made = ppl.reproduce(out, videos, workers=1, progress=False, say=said.append)
    assert said[0] == "1 of 2: simple"
    found = cells(made)
    people = found["people", "relations right"]
    assert people.ours["value"] == pytest.approx(0.85)
    assert people.verdict == "inside"
    assert found["people", "goals right"].missing == "people's judgments (--judgments)"
    of_scenario = found["simple", "goals right, competing"]
    assert of_scenario.verdict in ("inside", "outside")
    assert of_scenario.videos == 3
    assert found["absent", "relations right, competing"].missing == "torch is not installed"
    assert "--vlm" in found["Gemini", "r with people, goals"].missing
    assert found["PHASE", "share of friendly events"].ours["value"] == 0.25
    kept = json.loads((out / module.RESULT).read_text())
    assert [one["verdict"] for one in kept["cells"]] == [one.verdict for one in made.cells]
    table = pd.read_csv(out / module.TABLE, index_col="number", keep_default_na=False)
    assert set(table["verdict"]) == {"inside", "outside", "not computable"}
    assert table["place"].iloc[-1].startswith("Appendix A.2")
    page = (out / "comparison" / "report.html").read_text()
    for words in ("paper has 100 test videos, these are 12", "Accuracy by scenario"):
        assert words in page
    for words in ("0.59 [0.41, 0.77]", "0.965"):  # to the digits that are printed
        assert words in str(made)


def test_it_goes_on_with_what_is_finished(
    cheap: None, videos: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    asked: list[str] = []
    evaluate = module.evaluate

    def stops(events: Any, model: str, **given: Any) -> Any:
        asked.append(model)
        if model == "majority" and asked.count(model) == 1:
            raise KeyboardInterrupt
        return evaluate(events, model, **given)

    monkeypatch.setattr(module, "evaluate", stops)
    out = tmp_path / "out"
    command = ["reproduce", "--videos", str(videos), "--out", str(out), "--workers", "1", "--quiet"]
    assert main(command) == 130
    done = out / "models" / "simple"
    before = {file: file.stat().st_mtime_ns for file in done.glob("events/*/*")}
    assert before
    assert main(command) == 2, "it is not gone on with unasked"
    assert main([*command, "--resume"]) == 0
    again = {"workers": 1, "progress": False, "say": lambda line: None}
    with pytest.raises(OutputError, match="resume it"):
        ppl.reproduce(out, videos, **again)
    with pytest.raises(InvalidSettingError, match=r"with other settings: seed is 1, was 0"):
        ppl.reproduce(out, videos, seed=1, resume=True, **again)
    ppl.reproduce(out, videos, resume=True, **again)
    after = {file: file.stat().st_mtime_ns for file in done.glob("events/*/*")}
    assert after == before, "nothing is predicted twice"


def test_videos_that_people_steer_give_cells_where_they_are_judged(
    cheap: None, videos: Path, tmp_path: Path
) -> None:
    votes = [(9, 1, 0), (6, 2, 2), (1, 8, 1)]  # of three friendly events
    played = [make_event(f"played-{i}", COLLABORATIVE, one) for i, one in enumerate(votes)]
    ppl.save_events(played, tmp_path / "played.json")
    given = {"workers": 1, "progress": False, "say": lambda line: None}
    before = cells(ppl.reproduce(tmp_path / "out", videos, **given))
    right = STEERED, "mode of responses right, relations"
    assert "--steered" in before[right].missing
    file = tmp_path / "played.json"
    found = cells(ppl.reproduce(tmp_path / "out", videos, steered=file, resume=True, **given))
    assert found[right].ours["value"] == pytest.approx(2 / 3)
    assert "--steered" in found[STEERED, "mode of responses right, goals"].missing
    # beside them those of the generated videos: all modes of ``VOTES`` are right
    assert found["people", "mode of responses right, relations"].ours["value"] == 1
    assert "does not say" in found["PHASE", "most events of a goal category"].missing


def test_a_vision_language_model_is_asked_before(cheap: None, videos: Path, tmp_path: Path) -> None:
    def answers(request: Any) -> str:
        return text()

    given: dict[str, Any] = {"workers": 1, "progress": False, "say": lambda line: None}
    for n, name in ((None, "all"), (3, "some")):
        folder = tmp_path / name
        ppl.evaluate(videos, "vlm", client=answers, limit=n, out=folder, progress=False)
    found = cells(ppl.reproduce(tmp_path / "out", videos, vlm=tmp_path / "all", **given))
    assert found["vlm", "r with people, relations"].verdict in ("inside", "outside")
    with pytest.raises(InvalidEventError, match="some holds answers about other events than"):
        ppl.reproduce(tmp_path / "other", videos, vlm=tmp_path / "some", **given)


def test_generated_events_are_no_real_videos(cheap: None, tmp_path: Path) -> None:
    data = make_set(tmp_path / "set", eight()[:2], ["train", "test"])
    with pytest.raises(InvalidSettingError, match="holds generated events"):
        ppl.reproduce(tmp_path / "out", data, workers=1, progress=False)
