"""An evaluation that was interrupted or kept: resumed, added to, damaged, refused."""

from __future__ import annotations

import dataclasses
import json
from pathlib import Path
from typing import Any

import pytest

import phase_ppl as ppl
from phase_ppl.evaluation.folder import ResultsFolder
from phase_ppl.world.errors import InvalidEventError, InvalidSettingError, OutputError
from phase_ppl.world.event import Truth
from tests.evaluation.toys import (
    EVENTS,
    GREEN_TO_RED,
    Counted,
    evaluate,
    guesses,
    raises,
    several,
    still,
    wrong,
)


def test_finished_events_are_not_asked_again_and_failed_ones_are(tmp_path: Path) -> None:
    out, broken = tmp_path / "out", tmp_path / "broken"
    broken.touch()

    def fails_while_broken(scene: Any, observation: Any, seed: int) -> Any:
        if broken.exists() and observation.n_frames == 4:
            raise ValueError("broken")
        return guesses(scene, observation, seed)

    model = Counted(tmp_path / "calls", fails_while_broken)
    first = evaluate(model=model, out=out)
    assert list(first.failures) == ["b"]
    broken.unlink()
    second = evaluate(model=model, out=out, resume=True)
    assert model.calls() == {3: 1, 4: 2, 5: 1, 6: 1}
    assert not second.failures
    assert not (out / "failures.json").exists()
    whole = evaluate(model=guesses).predictions
    for name, given in second.predictions.items():
        assert given.probabilities["goal_red"].tolist() == pytest.approx(
            whole[name].probabilities["goal_red"].tolist(), abs=1e-15
        )


def test_resume_begins_where_there_is_nothing_and_goes_on_with_more_events(tmp_path: Path) -> None:
    model, out = Counted(tmp_path / "calls"), tmp_path / "out"
    assert len(evaluate(model=model, out=out, resume=True, limit=2).predictions) == 2
    assert len(evaluate(model=model, out=out, resume=True).predictions) == 4
    assert model.calls() == {3: 1, 4: 1, 5: 1, 6: 1}
    assert len(ResultsFolder.open(out).events) == 4
    with pytest.raises(InvalidSettingError, match="of 4 events, but 2 are given"):
        evaluate(model=model, out=out, resume=True, limit=2)


def test_truth_may_change_and_only_the_metrics_with_it(tmp_path: Path) -> None:
    model, out = Counted(tmp_path / "calls"), tmp_path / "out"
    evaluate(model=model, out=out)
    corrected = [
        dataclasses.replace(event, truth=Truth(GREEN_TO_RED, GREEN_TO_RED)) for event in EVENTS
    ]
    found = evaluate(corrected, model, out=out, resume=True)
    assert found.metrics["goal_accuracy"]["value"] == 0.5
    assert ResultsFolder.open(out).events[0].truth == corrected[0].truth
    assert sum(model.calls().values()) == 4


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"model": wrong}, "model is 'wrong', was 'right'"),
        ({"seed": 1}, "seed is 1, was 0"),
        ({"events": several(5)[1:]}, "number 1 is 'b', was 'a'"),
        ({"events": [still("a", 3, shift=0.3), *EVENTS[1:]]}, "another event 'a': its scene or"),
    ],
)
def test_other_settings_and_events_are_refused_and_named(
    changes: dict[str, Any], message: str, tmp_path: Path
) -> None:
    evaluate(out=tmp_path)
    evaluate([still("a"), *EVENTS[1:]], out=tmp_path, resume=True)  # the same event made again
    with pytest.raises(InvalidSettingError, match=message):
        evaluate(out=tmp_path, resume=True, **changes)
    assert (tmp_path / "metrics.json").exists()


def test_other_versions_are_refused_while_there_is_something_left(tmp_path: Path) -> None:
    evaluate(out=tmp_path, limit=2)
    file = tmp_path / "settings.json"
    record = json.loads(file.read_text())
    record["versions"]["numpy"] = "1.0"
    file.write_text(json.dumps(record))
    found = evaluate(out=tmp_path, resume=True, limit=2)
    assert found.settings["versions"]["numpy"] == "1.0"
    with pytest.raises(InvalidSettingError, match=r"other versions: numpy is '2.*', was '1\.0'"):
        evaluate(out=tmp_path, resume=True)


def test_settings_may_change_while_nothing_is_finished(tmp_path: Path) -> None:
    evaluate(model=lambda *_: raises(), out=tmp_path)
    assert evaluate(out=tmp_path, seed=3, resume=True).settings["seed"] == 3
    assert not (tmp_path / "failures.json").exists()


def test_results_are_not_overwritten(tmp_path: Path) -> None:
    evaluate(out=tmp_path)
    with pytest.raises(OutputError, match="already holds an evaluation; resume it"):
        evaluate(out=tmp_path)


def test_a_folder_that_cannot_be_written_is_found_out_first(tmp_path: Path) -> None:
    file = tmp_path / "file"
    file.touch()
    with pytest.raises(OutputError, match="cannot write into"):
        evaluate(model=lambda *given: pytest.fail("it was asked"), out=file)


NO_COST = '{"event": "b", "probabilities": {}, "answers": {}, "cost": 7}'


@pytest.mark.parametrize("content", ["", '{"event": "b", "proba', "[]", '{"event": "a"}', NO_COST])
def test_a_damaged_prediction_is_made_again_with_a_note(content: str, tmp_path: Path) -> None:
    model, out = Counted(tmp_path / "calls"), tmp_path / "out"
    first = evaluate(model=model, out=out)
    assert first.folder is not None
    damaged = first.folder.folder_of("b") / "prediction.json"
    damaged.write_text(content)
    with pytest.raises(InvalidEventError, match=r"prediction\.json"):
        ppl.Evaluation.load(out)
    second = evaluate(model=model, out=out, resume=True)
    assert model.calls() == {3: 1, 4: 2, 5: 1, 6: 1}
    assert len(second.notes) == 1
    assert str(damaged) in second.notes[0]
    assert "note: " in str(second)
    assert second.metrics["n_events"] == 4


@pytest.mark.parametrize(
    ("file", "content", "message"),
    [
        ("settings.json", "{", "settings.json: is not JSON"),
        ("settings.json", "{}", "its schema is None"),
        ("settings.json", '{"schema": "phase-ppl-evaluation-1"}', "other settings: model is"),
        ("events.json", "", "events.json: is empty"),
        ("events.json", None, "events.json: no such file"),
    ],
)
def test_a_damaged_folder_is_refused_with_the_file(
    file: str, content: str | None, message: str, tmp_path: Path
) -> None:
    evaluate(out=tmp_path)
    if content is None:
        (tmp_path / file).unlink()
    else:
        (tmp_path / file).write_text(content)
    with pytest.raises((InvalidEventError, InvalidSettingError), match=message):
        evaluate(out=tmp_path, resume=True)


def test_settings_that_lack_something_are_refused(tmp_path: Path) -> None:
    evaluate(out=tmp_path)
    path = tmp_path / "settings.json"
    settings = json.loads(path.read_text())
    for name in ("seed", "model"):
        del settings[name]
        path.write_text(json.dumps(settings))
        with pytest.raises(InvalidEventError, match=rf"settings\.json has no {name}"):
            ppl.Evaluation.load(tmp_path)


def test_settings_and_events_that_do_not_belong_together_are_refused(tmp_path: Path) -> None:
    evaluate(out=tmp_path)
    ppl.save_events(EVENTS[1:], tmp_path / "events.json")
    with pytest.raises(InvalidEventError, match="do not fit together"):
        evaluate(out=tmp_path, resume=True)


def test_what_a_killed_evaluation_left_half_done_is_cleared_away(tmp_path: Path) -> None:
    evaluate(out=tmp_path)
    half = tmp_path / "events" / ".part-12345678"
    half.mkdir()
    (half / "note.txt").touch()
    evaluate(out=tmp_path, resume=True)
    assert not half.exists()
