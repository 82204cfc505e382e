"""An evaluation: what is asked, kept, scored, shown and refused."""

from __future__ import annotations

import dataclasses
import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import xarray as xr

import phase_ppl as ppl
from phase_ppl.evaluation.folder import ResultsFolder
from phase_ppl.evaluation.registry import Predict
from phase_ppl.world.errors import (
    AnswerError,
    InvalidEventError,
    InvalidSettingError,
    OutputError,
    PhasePPLError,
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


def saying(given: Any) -> Any:
    return lambda scene, observation, seed: given


def never(scene: Any, observation: Any, seed: int) -> Any:
    pytest.fail("it was asked")


# --- answers -----------------------------------------------------------------------------------


def test_an_answer_may_have_several_forms() -> None:
    shares = [0.25, 0.75, 0]
    named = {"friendly": np.float32(0.25), "neutral": np.float64(0.75)}
    labelled = xr.DataArray(shares, {"relation": list("abc")})
    forms = [{"relation": one} for one in (shares, np.array(shares), named, labelled)]
    for given in (*forms, ppl.Prediction("of whatever event", forms[0]), ppl.Answer(forms[0])):
        found = evaluate(still(), saying(given)).predictions["still"]
        assert found.event_id == "still"
        assert found.probabilities["relation"].tolist() == shares
        assert found.answers == {"relation": "neutral"}


def test_a_model_may_be_seen_through_whatever_says_how() -> None:
    class Contrary:
        record: Mapping[str, Any] = {"observer": "contrary"}

        def seeing(self, model: Predict, world: ppl.World) -> Predict:
            assert world == ppl.worlds.PHASE
            return lambda *seen: {"relation": model(*seen)["relation"][::-1]}  # type: ignore[index]

    found = evaluate(still(), saying({"relation": [0.2, 0.3, 0.5]}), observer=Contrary())
    assert found.predictions["still"].probabilities["relation"].tolist() == [0.5, 0.3, 0.2]
    assert found.settings["observer"] == "contrary"
    assert found.posterior("still") is None


@pytest.mark.parametrize(
    ("does", "message"),
    [
        (raises, "ValueError: not today (toys.py, line"),
        (lambda: {"relation": [0.5, np.nan, 0.5]}, "relation has the probability nan"),
        (lambda: {"goal_red": [1.0]}, "shape (1,), expected (36,)"),
        (lambda: {"goal_blue": RED_TO_RED}, "unknown question 'goal_blue'"),
        (lambda: None, "the answer is None, expected a Prediction, a posterior or a mapping"),
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
    # an odd answer is none of the settings, whose text is kept where they are no plain data
    ppl.register_model("odd")(lambda **options: FailsAt(6, lambda: {"relation": "hostile"}))
    found = evaluate(model="odd", a=np.nan, b=raises, c=(1, np.float32(2)))
    assert list(found.failures) == ["d"]
    text = "tests.evaluation.toys.raises"
    assert found.settings["options"] == {"a": None, "b": text, "c": [1, 2.0]}


def test_a_posterior_is_an_answer_and_what_it_says_of_itself_is_kept(tmp_path: Path) -> None:
    made: dict[int, ppl.ClosedLoopPosterior] = {}

    def reads(scene: Any, observation: Any, seed: int) -> Any:
        if observation.n_frames == 5:
            return right(scene, observation, seed)  # which says nothing of itself
        post = made[observation.n_frames] = ppl.infer(ppl.Event(scene, observation), seed=seed)
        return post

    found = evaluate(EVENTS[:3], reads, out=tmp_path)
    assert not found.failures
    for one in (found, ppl.Evaluation.load(tmp_path)):
        for event in EVENTS[:3]:
            said, post = one.predictions[event.id], made.get(event.observation.n_frames)
            if post is None:
                assert (said.sure, said.decided, one.posterior(event.id)) == ({}, None, None)
                continue
            kept = one.posterior(event.id)
            assert kept is not None
            assert kept.event_id == event.id
            assert (
                said.probabilities["goal_red"].tolist() == post.marginal("goal_red").values.tolist()
            )
            assert said.sure == {name: it["sure"] for name, it in post.leaders().items()}
            assert said.decided == post.diagnostics()["decided"]
    table = found.to_dataframe().groupby("event")[["sure", "decided"]].first()
    assert table.loc["c"].isna().all()
    assert table.drop("c").notna().all(axis=None)
    scene = ppl.worlds.TRIO.random_scene(1)
    elsewhere = ppl.Event(scene, ppl.Observation(np.repeat(scene.start[None], 3, axis=0)))
    with pytest.raises(AnswerError, match="world 'PHASE', not 'trio'"):
        evaluate(elsewhere, saying(made[3]))


def test_accuracies_of_decided_and_undecided_answers_stand_side_by_side(tmp_path: Path) -> None:
    def told(scene: Any, observation: Any, seed: int) -> Any:
        n = observation.n_frames
        sure = {"goal_red": n != 4, "goal_green": n != 4, "relation": True}
        given = right if n > 4 else wrong
        answers = given(scene, observation, seed)
        return ppl.Prediction("", answers=answers, sure=sure, decided=n != 4) if n < 6 else answers

    found = evaluate(model=told, out=tmp_path)
    for one in (found, ppl.Evaluation.load(tmp_path)):
        verdict = one.metrics["verdict"]["relation"]
        assert {name: (it["n"], it["accuracy"]["value"]) for name, it in verdict.items()} == {
            "decided": (2, 0.5), "undecided": (1, 0), "sure": (3, 1 / 3),
        }  # fmt: skip
        assert "0.50 [0.01, 0.99] of 2" in str(one)
        where = "in decided events, in undecided events, where the answer is sure"
        assert f"relations right {where}\n" in str(one)
    changed(tmp_path / "events" / "0000-a" / "prediction.json", sure={"goal_red": "yes"})
    with pytest.raises(InvalidEventError, match="goal_red='yes', expected True or False"):
        ppl.Evaluation.load(tmp_path)
    assert evaluate().metrics["verdict"] == {"goal": {}, "relation": {}}
    shares = {"relation": [0.5, 0.25, 0.25]}
    unknown = ppl.Prediction("", shares, errors={"relation": [np.nan] * 3}, decided=False)
    words = "errors of all answers are unknown (they need two sets of searches"
    assert words in " ".join(str(evaluate(model=saying(unknown))).split())


def test_the_tidy_table_has_a_row_per_event_question_and_label() -> None:
    votes = {"relation_counts": {"friendly": 1, "neutral": 3}}
    events = [
        dataclasses.replace(EVENTS[0], judgments=votes),
        dataclasses.replace(EVENTS[1], truth=None),
    ]
    errors = {"relation": [0.1, 0.2, np.nan]}
    shares = {"relation": [0.25, 0.75, 0]}
    said = ppl.Prediction("", shares, {"goal_red": RED_TO_RED}, errors=errors)
    table = evaluate([*events, EVENTS[3]], FailsAt(6, raises), seed=2).to_dataframe()
    assert table["event"].unique().tolist() == ["a", "b"]
    table = evaluate(events, saying(said)).to_dataframe()
    assert len(table) == 2 * (36 + 3)
    assert table.dtypes.astype(str).to_dict() == {
        **dict.fromkeys(("event", "question", "label", "model"), table["event"].dtype.name),
        **{"probability": "float64", "error": "float64", "answer": "bool"},
        **dict.fromkeys(("truth", "sure", "decided"), "boolean"),
        **{"people": "float64", "n": "int64", "at": "float64"},
    }
    relation = table[(table["event"] == "a") & (table["question"] == "relation")]
    shown = ["label", "probability", "answer", "truth", "people", "n"]
    assert relation[shown].values.tolist() == [
        ["friendly", 0.25, False, False, 0.25, 4],
        ["neutral", 0.75, True, True, 0.75, 4],
        ["adversarial", 0, False, False, 0, 4],
    ]
    assert np.array_equal(relation["error"], errors["relation"], equal_nan=True)
    other = table[table["event"] == "b"]
    assert other[["truth", "people"]].isna().all(axis=None)
    assert set(other["n"]) == {0}
    goals = table[table["question"] == "goal_red"]
    assert goals["probability"].isna().all()
    assert goals.loc[goals["answer"], "label"].tolist() == [RED_TO_RED] * 2


# --- what a model gets to know -----------------------------------------------------------------


def test_a_model_gets_what_is_seen_and_a_seed_that_follows_from_it_alone() -> None:
    asked: list[Any] = []

    def curious(*given: Any) -> Any:
        asked.append(given)
        return guesses(*given)

    def drawn(events: Any, **more: Any) -> dict[str, bytes]:
        """Return what a model that only has its seed says of each event."""
        found = evaluate(events, curious, **more).predictions
        return {name: given.probabilities["goal_red"].tobytes() for name, given in found.items()}

    every = drawn(EVENTS)
    assert len(set(every.values())) == 4
    assert drawn(EVENTS[::-1], limit=2) == {name: every[name] for name in "dc"}
    assert set(drawn(EVENTS, seed=1).values()).isdisjoint(every.values())
    truth = Truth("get to green agent", "get to red agent")
    said = {"judgments": {"relation_counts": {"friendly": 9}}, "predictions": {"someone": WRONG}}
    other = dataclasses.replace(EVENTS[1], id="other", truth=truth, **said)
    assert drawn(other) == {"other": every["b"]}
    for given in asked:
        assert tuple(map(type, given)) == (ppl.Scene, ppl.Observation, int)


def test_longest_events_come_first_and_a_model_cannot_change_what_others_see() -> None:
    order: list[int] = []

    def vandal(scene: Any, observation: Any, seed: int) -> Any:
        order.append(observation.n_frames)
        observation.trajectory[:] = 0

    with pytest.raises(
        AnswerError, match=r"'vandal' failed at 4 of 4 events; event 'b': .*read-only"
    ):
        evaluate([EVENTS[1], EVENTS[3], EVENTS[0], EVENTS[2]], vandal)
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


def test_what_cannot_be_evaluated_is_refused_at_once() -> None:
    votes = {"relation_counts": {"hostile": 1}}
    cases: tuple[tuple[Any, str], ...] = (
        ({"events": []}, "no events"),
        ({"events": [3]}, "3 is no event"),
        ({"events": "nowhere.json"}, "nowhere.json: no such file"),
        ({"events": [still(predictions={"x": 1})]}, "still: predictions: x"),
        ({"events": [still(judgments=votes)]}, "hostile"),
        ({"workers": 0}, "workers=0"),
    )
    for given, message in cases:
        with pytest.raises(PhasePPLError, match=message):
            evaluate(model=never, **given)


# --- what is kept ------------------------------------------------------------------------------


def test_metrics_hold_what_is_promised_as_plain_json(tmp_path: Path) -> None:
    votes = {"relation_counts": {"friendly": 1, "neutral": 3}}
    judged = dataclasses.replace(EVENTS[0], judgments=votes, predictions={"rival": WRONG})
    found = evaluate([judged, *EVENTS[1:]], out=tmp_path)

    def refuse(constant: str) -> None:
        raise AssertionError(constant)

    kept = json.loads((tmp_path / "metrics.json").read_text(), parse_constant=refuse)
    again = ppl.Evaluation.load(tmp_path)
    assert kept == found.metrics == again.metrics
    assert str(again) == str(found)
    assert set(kept) >= {
        *("n_events", "goal_accuracy", "goal_top3_accuracy", "relation_accuracy", "by_scenario"),
        *("calibration", "human", "people", "reference_models", "failures"),
        *("settings", "cost"),
    }
    of_all = ("", "reference_models.rival.", "people.")
    right = values(kept, "goal_accuracy", *(f"{who}relation_accuracy" for who in of_all))
    assert right == [1, 1, 0, 0.75]
    assert set(kept["cost"]) == {"seconds", "simulations", "events"}
    cost = {"simulations": np.int64(7), "loss": np.nan, "device": Path("x"), "seconds": -1}
    given = ppl.Prediction("", answers={"relation": "friendly"}, cost=cost)
    told = evaluate(model=saying(given)).metrics["cost"]
    assert told["simulations"] == 28
    assert told["events"]["a"]["loss"] is None
    assert told["seconds"] == sum(entry["seconds"] for entry in told["events"].values()) > 0
    assert (kept["settings"]["model"], kept["settings"]["seed"]) == ("right", 0)
    assert "workers" not in json.dumps(kept["settings"])


# --- what is shown -----------------------------------------------------------------------------


def test_the_table_shows_everybody_and_fits_a_terminal(tmp_path: Path) -> None:
    rivals = {f"a_rival_with_a_long_name_{i}": WRONG for i in range(4)}
    votes = {"relation_counts": {"neutral": 3, "friendly": 1}}
    events = [dataclasses.replace(e, predictions=rivals, judgments=votes) for e in EVENTS]
    found = evaluate(events, FailsAt(3, raises), out=tmp_path / ("long" * 30))
    printed = str(found)
    assert max(map(len, printed.splitlines())) <= 100
    assert len(printed.splitlines()) <= 40
    more = str(evaluate(events, guesses))
    assert len(more.splitlines()) <= 40
    assert "agreement with people on relations" in more
    assert "not shown, but in .metrics and ppl.report: " in more
    names = [f"g_name_{i}" for i in range(4)]
    assert all(w in printed for w in ("people", *names, "1.00 [0.29, 1.00]", "independent (4)"))


# --- interrupted, kept and gone on with -----------------------------------------------------------


def test_ctrl_c_keeps_all_that_was_done(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def stops(*given: Any) -> Any:
        raise KeyboardInterrupt

    with pytest.raises(ppl.EvaluationInterrupted, match=r"2 of 4 events.*kept in") as caught:
        evaluate(model=FailsAt(4, stops), out=tmp_path / "asked")
    assert list(caught.value.evaluation.predictions) == ["c", "d"]
    assert caught.value.evaluation.metrics["n_events"] == 2
    assert not (tmp_path / "asked" / "metrics.json").exists()

    add = ResultsFolder.add
    monkeypatch.setattr(ResultsFolder, "add", lambda *given: stops(add(*given)))
    with pytest.raises(ppl.EvaluationInterrupted, match=r"1 of 4 events.*kept in") as caught:
        evaluate(out=tmp_path / "kept")
    assert list(caught.value.evaluation.predictions) == ["d"]


def test_an_evaluation_is_gone_on_with_where_it_is_not_finished(tmp_path: Path) -> None:
    out, broken = tmp_path / "out", tmp_path / "broken"
    broken.touch()

    def fails_while_broken(scene: Any, observation: Any, seed: int) -> Any:
        if broken.exists() and observation.n_frames == 4:
            raise ValueError("broken")
        return guesses(scene, observation, seed)

    model = Counted(tmp_path / "calls", fails_while_broken)
    go_on = {"model": model, "out": out, "resume": True}
    first = evaluate(**go_on, limit=2)  # also where there is nothing yet
    assert (list(first.predictions), list(first.failures)) == (["a"], ["b"])
    broken.unlink()
    half = out / "events" / ".part-12345678"  # a killed evaluation left it half done
    half.mkdir()
    (half / "note.txt").touch()
    whole = evaluate(**go_on)
    assert model.calls() == {3: 1, 4: 2, 5: 1, 6: 1}
    assert not whole.failures
    assert not half.exists()
    assert not (out / "failures.json").exists()
    assert len(ResultsFolder.open(out).events) == 4
    for name, alone in evaluate(model=guesses).predictions.items():
        again = whole.predictions[name].probabilities["goal_red"]
        np.testing.assert_allclose(again, alone.probabilities["goal_red"], rtol=0, atol=1e-15)
    with pytest.raises(InvalidSettingError, match="of 4 events, but 2 are given"):
        evaluate(**go_on, limit=2)
    # truth may change, and only the metrics with it
    truth = Truth(GREEN_TO_RED, GREEN_TO_RED)
    found = evaluate([dataclasses.replace(event, truth=truth) for event in EVENTS], **go_on)
    right = [given.answers["relation"] == truth.relation for given in whole.predictions.values()]
    assert found.metrics["relation_accuracy"]["value"] == np.mean(right)
    assert ResultsFolder.open(out).events[0].truth == truth
    assert sum(model.calls().values()) == 5


def test_other_settings_and_events_are_refused_and_named(tmp_path: Path) -> None:
    evaluate(out=tmp_path)
    evaluate([still("a"), *EVENTS[1:]], out=tmp_path, resume=True)  # the same event made again
    changes: list[tuple[dict[str, Any], str]] = [
        ({"model": wrong}, "model is 'wrong', was 'right'"),
        ({"seed": 1}, "seed is 1, was 0"),
        ({"events": several(5)[1:]}, "number 1 is 'b', was 'a'"),
        (
            {"events": [still("a", shift=0.3), *EVENTS[1:]]},
            "number 1 is 'a', was 'a', whose scene or",
        ),
    ]
    for change, message in changes:
        with pytest.raises(InvalidSettingError, match=message):
            evaluate(out=tmp_path, resume=True, **change)
    assert (tmp_path / "metrics.json").exists()


def test_other_versions_are_refused_while_there_is_something_left(tmp_path: Path) -> None:
    before = {**evaluate(out=tmp_path, limit=2).settings["versions"], "numpy": "1.0"}
    changed(tmp_path / "settings.json", versions=before)
    found = evaluate(out=tmp_path, resume=True, limit=2)
    assert found.settings["versions"]["numpy"] == "1.0"
    with pytest.raises(InvalidSettingError, match=r"other versions: numpy is '2.*', was '1\.0'"):
        evaluate(out=tmp_path, resume=True)


def test_while_nothing_is_finished_settings_may_change(tmp_path: Path) -> None:
    with pytest.raises(
        AnswerError, match="failed at 4 of 4 events; event 'a': ValueError"
    ) as caught:
        evaluate(model=lambda *_: raises(), out=tmp_path)
    for found in (caught.value.evaluation, ppl.Evaluation.load(tmp_path)):
        assert (len(found.failures), found.metrics["n_events"]) == (4, 0)
        assert found.metrics["goal_accuracy"] is None
    assert "0 of 4 events" in str(found)
    assert "4 in all, see .failures" in str(found)
    assert json.loads((tmp_path / "metrics.json").read_text())["failures"] == found.failures
    assert evaluate(out=tmp_path, seed=3, resume=True).settings["seed"] == 3
    assert not (tmp_path / "failures.json").exists()


def test_a_folder_that_cannot_be_written_is_found_out_first(tmp_path: Path) -> None:
    evaluate(out=tmp_path / "out")
    file = tmp_path / "file"
    file.touch()
    for out, message in ((file, "cannot write into"), (tmp_path / "out", "already holds.*resume")):
        with pytest.raises(OutputError, match=message):
            evaluate(model=never, out=out)


def test_a_damaged_prediction_is_made_again_with_a_note(tmp_path: Path) -> None:
    model, out = Counted(tmp_path / "calls"), tmp_path / "out"
    first = evaluate(model=model, out=out)
    assert first.folder is not None
    damaged = first.folder.folder_of("b") / "prediction.json"
    no_cost = '{"event": "b", "probabilities": {}, "answers": {}, "cost": 7}'
    of_another = (first.folder.folder_of("a") / "prediction.json").read_text()
    contents = ("", '{"event": "b", "proba', "[]", of_another, no_cost)
    for times, content in enumerate(contents, 2):
        damaged.write_text(content)
        with pytest.raises(InvalidEventError, match=r"prediction\.json"):
            ppl.Evaluation.load(out)
        again = evaluate(model=model, out=out, resume=True)
        assert model.calls() == {3: 1, 4: times, 5: 1, 6: 1}
        (note,) = again.notes
        assert str(damaged) in note
        assert "note: " in str(again)
        assert again.metrics["n_events"] == 4


def test_a_damaged_folder_is_refused_with_the_file(tmp_path: Path) -> None:
    evaluate(out=tmp_path)
    settings = json.loads((tmp_path / "settings.json").read_text())
    nameless = {name: value for name, value in settings.items() if name != "model"}
    for file, content, message in (
        ("settings.json", "{", "settings.json: is not JSON"),
        ("settings.json", "{}", "its schema is None"),
        ("settings.json", json.dumps(nameless), r"settings\.json has no model"),
        ("events.json", None, "events.json: no such file"),
    ):
        whole = (tmp_path / file).read_text()
        (tmp_path / file).unlink() if content is None else (tmp_path / file).write_text(content)
        with pytest.raises(InvalidEventError, match=message):
            ppl.Evaluation.load(tmp_path)
        with pytest.raises((InvalidEventError, InvalidSettingError)):
            evaluate(out=tmp_path, resume=True)
        (tmp_path / file).write_text(whole)
    ppl.save_events(EVENTS[1:], tmp_path / "events.json")
    with pytest.raises(InvalidEventError, match="do not fit together"):
        evaluate(out=tmp_path, resume=True)
