"""An evaluation: what is asked, kept, scored, shown and refused."""

from __future__ import annotations

import dataclasses
import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import xarray as xr

import phase_ppl as ppl
from phase_ppl.evaluation.evaluate import Progress
from phase_ppl.evaluation.evaluation import ResultsFolder
from phase_ppl.world.errors import (
    InvalidEventError,
    InvalidSettingError,
    OutputError,
    UnknownNameError,
)
from phase_ppl.world.event import Truth
from tests.evaluation.judged import values
from tests.evaluation.toys import (
    EVENTS,
    GREEN_TO_RED,
    RED_TO_RED,
    Counted,
    FailsAt,
    changed,
    evaluate,
    guesses,
    raises,
    right,
    several,
    still,
    wrong,
)

WRONG = {"relation": "friendly"}
"""A prediction in the events, of which all are neutral."""

# --- answers -----------------------------------------------------------------------------------


@pytest.mark.parametrize(
    "given",
    [
        {"relation": {"friendly": 0.25, "neutral": 0.75}},
        {"relation": {"friendly": np.float32(0.25), "neutral": np.float64(0.75)}},
        {"relation": [0.25, 0.75, 0]},
        {"relation": np.array([0.25, 0.75, 0])},
        {"relation": xr.DataArray([0.25, 0.75, 0], {"relation": list("abc")})},
        ppl.Prediction("of whatever event", {"relation": [0.25, 0.75, 0]}),
        ppl.Answer({"relation": [0.25, 0.75, 0]}),
    ],
)
def test_an_answer_may_have_several_forms(given: Any) -> None:
    found = evaluate(still(), lambda scene, observation, seed: given).predictions["still"]
    assert found.event_id == "still"
    assert found.probabilities["relation"].tolist() == [0.25, 0.75, 0]
    assert found.answers == {"relation": "neutral"}


def test_what_an_answer_cost_is_kept_as_plain_data(tmp_path: Path) -> None:
    cost = {"simulations": np.int64(7), "loss": np.nan, "device": Path("x"), "seconds": -1}
    given = ppl.Prediction("", answers={"relation": "friendly"}, cost=cost)
    found = evaluate(model=lambda scene, observation, seed: given, out=tmp_path)
    kept = json.loads((tmp_path / "metrics.json").read_text())["cost"]
    assert kept["simulations"] == 28
    assert kept["events"]["a"]["loss"] is None
    assert kept["seconds"] == sum(entry["seconds"] for entry in kept["events"].values()) > 0
    assert "28 simulations" in str(found)


@pytest.mark.parametrize(
    ("does", "message"),
    [
        (raises, "ValueError: not today (toys.py, line"),
        (lambda: {"relation": [0.5, np.nan, 0.5]}, "relation has the probability nan"),
        (lambda: {"goal_red": np.ones(36)}, "goal_red has probabilities of sum 36"),
        (lambda: {"goal_red": [1.0]}, "shape (1,), expected (36,)"),
        (lambda: {"goal_red": "Get blue item to red landmark"}, "'Get blue item to red lm'"),
        (lambda: {"goal_blue": RED_TO_RED}, "unknown question 'goal_blue'"),
        (lambda: {"relation": None}, "the answer is empty"),
        (lambda: {}, "the answer is empty"),
        (lambda: None, "the answer is None, expected a Prediction or a mapping"),
        (lambda: exit(3), "SystemExit: 3"),
    ],
)
def test_what_fails_at_one_event_is_reported_and_does_not_stop_the_rest(
    does: Any, message: str, tmp_path: Path
) -> None:
    found = evaluate(model=FailsAt(4, does), out=tmp_path)
    assert list(found.failures) == ["b"]
    assert message in found.failures["b"]
    assert list(found.predictions) == ["a", "c", "d"]
    assert found.metrics["n_events"] == 3
    for file in ("failures.json", "metrics.json"):
        kept = json.loads((tmp_path / file).read_text())
        assert kept.get("failures", kept) == found.failures
    assert "failed: b: " in str(found)


@pytest.mark.usefixtures("own_models")
def test_a_setting_of_a_named_model_that_nothing_can_use_stops_at_once(tmp_path: Path) -> None:
    def fussy(scene: Any, observation: Any, seed: int) -> Any:
        raise InvalidSettingError("size=3 is too small")

    ppl.register_model("fussy")(lambda: fussy)
    with pytest.raises(InvalidSettingError, match=r"model 'fussy', event 'd': .*too small"):
        evaluate(model="fussy", out=tmp_path)
    evaluate(out=tmp_path)  # nothing was done, so nothing is in the way
    # an odd answer is none of the settings
    ppl.register_model("odd")(lambda: FailsAt(6, lambda: {"relation": "hostile"}))
    assert list(evaluate(model="odd").failures) == ["d"]


@pytest.mark.usefixtures("own_models")
def test_options_that_are_no_plain_data_are_kept_as_text(tmp_path: Path) -> None:
    ppl.register_model("any")(lambda **options: right)
    options = {"a": np.nan, "b": raises, "c": (1, np.float32(2))}
    evaluate(model="any", out=tmp_path, **options)
    found = evaluate(model="any", out=tmp_path, resume=True, **options)
    assert found.settings["options"] == {
        "a": None,
        "b": "tests.evaluation.toys.raises",
        "c": [1, 2.0],
    }


# --- what a model gets to know -----------------------------------------------------------------


def seeds(events: Any, **more: Any) -> dict[str, str]:
    """Return what a model that only has its seed says of each event."""
    found = evaluate(events, guesses, **more).predictions
    return {name: given.probabilities["goal_red"].tobytes() for name, given in found.items()}


def test_seeds_follow_from_seed_and_content_alone() -> None:
    every = seeds(EVENTS)
    assert len(set(every.values())) == 4
    assert seeds(EVENTS[::-1], limit=2) == {name: every[name] for name in "dc"}
    assert seeds(dataclasses.replace(EVENTS[1], id="other"))["other"] == every["b"]
    assert set(seeds(EVENTS, seed=1).values()).isdisjoint(every.values())


def test_truth_judgments_and_references_do_not_reach_a_model() -> None:
    asked: list[Any] = []

    def curious(*given: Any) -> Any:
        asked.append(given)
        return guesses(*given)

    event = still()
    truth = Truth("get to green agent", "get to red agent")
    said = {"judgments": {"relation_counts": {"friendly": 9}}, "predictions": {"someone": WRONG}}
    other = dataclasses.replace(event, id="x", truth=truth, **said)
    one, two = (evaluate(e, curious).predictions[e.id] for e in (event, other))
    for question, given in one.probabilities.items():
        assert given.tobytes() == two.probabilities[question].tobytes()
    for scene, observation, seed in asked:
        assert (type(scene), type(observation), type(seed)) == (ppl.Scene, ppl.Observation, int)


def test_a_model_cannot_change_what_others_see() -> None:
    def vandal(scene: Any, observation: Any, seed: int) -> Any:
        observation.trajectory[:] = 0

    found = evaluate(still(), vandal)
    assert "read-only" in found.failures["still"]


def test_longest_events_come_first(tmp_path: Path) -> None:
    order: list[int] = []

    def noted(scene: Any, observation: Any, seed: int) -> Any:
        order.append(observation.n_frames)
        return right(scene, observation, seed)

    evaluate([EVENTS[1], EVENTS[3], EVENTS[0], EVENTS[2]], noted)
    assert order == [6, 5, 4, 3]


# --- events ------------------------------------------------------------------------------------


def test_events_come_from_a_file_a_folder_or_a_bundled_name(tmp_path: Path) -> None:
    folder = tmp_path / "some events"
    folder.mkdir()
    ppl.save_event(EVENTS[0], folder / "2.json")
    ppl.save_events(EVENTS[1:3], folder / "1.json")
    (folder / "notes.txt").write_text("no event")
    assert list(evaluate(folder).predictions) == ["b", "c", "a"]
    assert list(evaluate(folder / "1.json", limit=1).predictions) == ["b"]
    assert list(evaluate("collaborate").predictions) == ["collaborate"]
    ppl.save_event(EVENTS[1], folder / "3.json")
    with pytest.raises(InvalidEventError, match=r"two events with the id 'b'.*1\.json and .*3\.js"):
        evaluate(folder)
    (tmp_path / "empty").mkdir()
    with pytest.raises(InvalidEventError, match="holds no event files"):
        evaluate(tmp_path / "empty")


@pytest.mark.parametrize(
    ("given", "error", "message"),
    [
        ({"events": []}, InvalidEventError, "no events"),
        ({"events": [EVENTS[0]] * 2}, InvalidEventError, "two events with the id 'a'"),
        ({"events": [3]}, InvalidEventError, "3 is no event"),
        ({"events": "nowhere.json"}, InvalidEventError, "nowhere.json: no such file"),
        ({"events": [still(predictions={"x": 1})]}, InvalidEventError, "still: predictions: x"),
        ({"events": [still(judgments={"relation_counts": {"hostile": 1}})]}, UnknownNameError,
         "hostile"),
        ({"limit": 0}, InvalidSettingError, "limit=0"),
        ({"workers": 0}, InvalidSettingError, "workers=0"),
    ],
)  # fmt: skip
def test_what_cannot_be_evaluated_is_refused_at_once(
    given: Any, error: type[Exception], message: str
) -> None:
    with pytest.raises(error, match=message):
        evaluate(model=lambda *given: pytest.fail("it was asked"), **given)


# --- what is kept ------------------------------------------------------------------------------


def test_metrics_hold_what_is_promised_as_plain_json(tmp_path: Path) -> None:
    votes = {"relation_counts": {"friendly": 1, "neutral": 3}}
    judged = dataclasses.replace(EVENTS[0], judgments=votes, predictions={"rival": WRONG})
    found = evaluate([judged, *EVENTS[1:]], out=tmp_path)

    def refuse(constant: str) -> None:
        raise AssertionError(constant)

    kept = json.loads((tmp_path / "metrics.json").read_text(), parse_constant=refuse)
    assert kept == found.metrics
    again = ppl.Evaluation.load(tmp_path)
    assert (again.metrics, str(again)) == (kept, str(found))
    assert set(kept) >= {
        *("n_events", "goal_accuracy", "goal_top3_accuracy", "relation_accuracy", "by_scenario"),
        *("calibration", "confusion", "human", "people", "reference_models", "failures"),
        *("settings", "cost"),
    }
    of_all = ("", "reference_models.rival.", "people.")
    right = values(kept, "goal_accuracy", *(f"{who}relation_accuracy" for who in of_all))
    assert right == [1, 1, 0, 0.75]
    assert set(kept["cost"]) == {"seconds", "simulations", "workers", "wall_seconds", "events"}
    assert set(kept["cost"]["events"]) == set("abcd")
    assert (kept["settings"]["model"], kept["settings"]["seed"]) == ("right", 0)
    assert "workers" not in json.dumps(kept["settings"])


def test_files_that_belong_to_an_answer_are_kept_beside_it(tmp_path: Path) -> None:
    def write(path: Path) -> None:
        path.write_text("a note")

    answered = lambda *given: ppl.Answer(right(*given), {"note.txt": write})  # noqa: E731
    found = evaluate(model=answered, out=tmp_path)
    assert len(list(tmp_path.glob("events/*/note.txt"))) == 4
    assert found.folder is not None
    assert (found.folder.folder_of("b") / "note.txt").read_text() == "a note"
    unwritten = lambda *given: ppl.Answer(right(*given), {"note.txt": raises})  # noqa: E731
    assert not evaluate(model=unwritten).failures


def test_judgments_from_a_file_take_the_place_of_those_in_the_events(tmp_path: Path) -> None:
    file = tmp_path / "people.csv"
    file.write_text("participant,video,relation\np1,a,neutral\np2,a,friendly\np1,d,friendly\n")
    found = evaluate(judgments=file, limit=2)
    assert found.metrics["n"]["relation_judgments"] == 1
    assert found.metrics["people"]["relation_accuracy"]["value"] == 0.5
    with pytest.raises(UnknownNameError, match="'a'"):
        evaluate(EVENTS[1:], judgments=file)


# --- two models --------------------------------------------------------------------------------


def test_differences_are_paired_over_common_events(tmp_path: Path) -> None:
    one = evaluate(EVENTS[:3], right)
    two = evaluate(EVENTS[1:], wrong, out=tmp_path)
    found = one.against(tmp_path)
    assert (found["one"], found["other"], found["n_events"]) == ("right", "wrong", 2)
    # the wrong one names the green agent's goal for red, and no goal for green
    assert values(found, "goal_accuracy", "relation_accuracy") == [1, 1]
    assert values(two.against(one), "relation_accuracy") == [-1]
    json.dumps(found, allow_nan=False)


def test_opponents_are_models_that_have_seen_the_same() -> None:
    one = evaluate(
        [dataclasses.replace(event, predictions={"rival": WRONG}) for event in EVENTS[:2]]
    )
    assert values(one.against("rival"), "relation_accuracy") == [1]
    others: list[tuple[Any, type[Exception], str]] = [
        ("rivla", InvalidEventError, r"rivla: no such folder.*\(rival\)"),
        (evaluate(EVENTS[2:]), InvalidSettingError, "right predicts none of the 2 events"),
        (evaluate([still("a", shift=0.7)]), InvalidEventError, "'a' is not the same in both"),
        (3, InvalidSettingError, "3 is neither an evaluation"),
    ]
    for other, error, message in others:
        with pytest.raises(error, match=message):
            one.against(other)


# --- what is shown -----------------------------------------------------------------------------


def test_the_table_shows_everybody_and_fits_a_terminal(tmp_path: Path) -> None:
    rivals = {f"a_rival_with_a_long_name_{i}": WRONG for i in range(4)}
    votes = {"relation_counts": {"neutral": 3, "friendly": 1}}
    events = [dataclasses.replace(e, predictions=rivals, judgments=votes) for e in EVENTS]
    found = evaluate(events, FailsAt(3, raises), out=tmp_path / ("long" * 30))
    printed = str(found)
    assert max(map(len, printed.splitlines())) <= 100
    names = [f"g_name_{i}" for i in range(4)]
    assert all(w in printed for w in ("people", *names, "1.00 [0.29, 1.00]", "independent (4)"))
    assert repr(found) == "<Evaluation of FailsAt: 3 of 4 events, 1 failed>"


def test_the_bar_counts_events_and_says_what_fails(capsys: pytest.CaptureFixture[str]) -> None:
    evaluate(model=FailsAt(4, raises), progress=True)
    shown = capsys.readouterr().err
    assert "4/4" in shown
    assert "model 'FailsAt', event 'b': ValueError: not today" in shown
    evaluate(model=FailsAt(4, raises))
    assert not capsys.readouterr().err


def test_the_time_left_rests_on_seconds_per_frame_and_workers() -> None:
    events = [still("long", 100), still("short", 40), still("other", 60)]
    with Progress(events, 0, workers=2, shown=False) as bar:
        assert bar.seconds_left() is None
        bar.one_more("long", 50.0)
        assert bar.seconds_left() == pytest.approx((40 + 60) * 0.5 / 2)
        bar.one_more("other", None)  # failed: says nothing of the pace
        assert bar.seconds_left() == pytest.approx(40 * 0.5)
        bar.one_more("short", 20.0)
        assert bar.seconds_left() == 0


# --- interrupted, kept and gone on with -----------------------------------------------------------


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
    for name, whole in evaluate(model=guesses).predictions.items():
        again = second.predictions[name].probabilities["goal_red"]
        np.testing.assert_allclose(again, whole.probabilities["goal_red"], rtol=0, atol=1e-15)


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
    truth = Truth(GREEN_TO_RED, GREEN_TO_RED)
    corrected = [dataclasses.replace(event, truth=truth) for event in EVENTS]
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
    before = {**evaluate(limit=1).settings["versions"], "numpy": "1.0"}
    changed(tmp_path / "settings.json", versions=before)
    found = evaluate(out=tmp_path, resume=True, limit=2)
    assert found.settings["versions"]["numpy"] == "1.0"
    with pytest.raises(InvalidSettingError, match=r"other versions: numpy is '2.*', was '1\.0'"):
        evaluate(out=tmp_path, resume=True)


def test_while_nothing_is_finished_there_are_no_figures_and_settings_may_change(
    tmp_path: Path,
) -> None:
    found = evaluate(model=lambda *_: raises(), out=tmp_path)
    assert (len(found.failures), found.metrics["n_events"]) == (4, 0)
    assert found.metrics["goal_accuracy"] is None
    assert "0 of 4 events" in str(found)
    assert evaluate(out=tmp_path, seed=3, resume=True).settings["seed"] == 3
    assert not (tmp_path / "failures.json").exists()


def test_a_folder_that_cannot_be_written_is_found_out_first(tmp_path: Path) -> None:
    evaluate(out=tmp_path / "out")
    file = tmp_path / "file"
    file.touch()
    asked = lambda *given: pytest.fail("it was asked")  # noqa: E731
    for out, message in ((file, "cannot write into"), (tmp_path / "out", "already holds.*resume")):
        with pytest.raises(OutputError, match=message):
            evaluate(model=asked, out=out)


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
    (note,) = second.notes
    assert str(damaged) in note
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


def test_what_does_not_belong_together_is_refused(tmp_path: Path) -> None:
    evaluate(out=tmp_path)
    ppl.save_events(EVENTS[1:], tmp_path / "events.json")
    with pytest.raises(InvalidEventError, match="do not fit together"):
        evaluate(out=tmp_path, resume=True)
    path = tmp_path / "settings.json"
    settings = json.loads(path.read_text())
    for name in ("seed", "model"):
        del settings[name]
        path.write_text(json.dumps(settings))
        with pytest.raises(InvalidEventError, match=rf"settings\.json has no {name}"):
            ppl.Evaluation.load(tmp_path)


def test_what_a_killed_evaluation_left_half_done_is_cleared_away(tmp_path: Path) -> None:
    evaluate(out=tmp_path)
    half = tmp_path / "events" / ".part-12345678"
    half.mkdir()
    (half / "note.txt").touch()
    evaluate(out=tmp_path, resume=True)
    assert not half.exists()
