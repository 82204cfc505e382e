"""SIMPLE in one word: what a preset fixes, and what is given beside it."""

from __future__ import annotations

import dataclasses
import functools
import json
from pathlib import Path
from typing import Any

import pytest

import phase_ppl as ppl
from phase_ppl.cli import main
from phase_ppl.evaluation.registry import ready
from phase_ppl.inference.run import Run
from phase_ppl.inference.settings import completed
from phase_ppl.models.predicate import INDEPENDENT, PredicateSettings
from phase_ppl.simulator.joint import DynamicsNoise
from phase_ppl.world.errors import InvalidSettingError, UnknownNameError
from tests.inference.toy import walkers, walking_event

PRINTED = ppl.preset("as_printed")["settings"]


def test_a_preset_is_ones_own_to_change_and_simple_is_its_kernel() -> None:
    printed = ppl.preset("as_printed")
    assert ppl.preset("simple") == {"kernel": "local_mh"}
    printed["chains"] = 3  # one's own to change
    assert ppl.preset("as_printed")["chains"] == 15
    guided = {"proposal": "closed_loop", "eta": 0.2}
    wanted = {"kernel": "local_mh", "settings": ppl.SimpleSettings(**guided)}
    assert completed("guided", {"eta": 0.2}) == wanted


def test_what_is_given_goes_before_a_preset() -> None:
    for given, changed, gone in [
        ({"chains": 4, "planner": None}, {"chains": 4}, set()),
        ({"budget": 30}, {"budget": 30}, {"iterations"}),
        ({"kernel": "local_mh", "rule": "exact"}, {"rule": "exact"}, set()),
        ({"kernel": "prior_mh"}, {"kernel": "prior_mh"},
         {"rule", "weights", "iterations", "chains"}),
        ({"eta": 0.2},
         {"settings": dataclasses.replace(PRINTED, eta=0.2)}, set()),
        ({"settings": ppl.SimpleSettings()}, {"settings": ppl.SimpleSettings()}, set()),
    ]:  # fmt: skip
        wanted = {**ppl.preset("as_printed"), **changed}
        assert completed("as_printed", given) == {k: v for k, v in wanted.items() if k not in gone}


def test_unknown_words_and_settings_whole_and_one_by_one_are_refused() -> None:
    with pytest.raises(UnknownNameError, match="'as_printed'"):
        ppl.preset("as_print")
    with pytest.raises(InvalidSettingError, match="either settings or eta"):
        completed("simple", {"settings": PRINTED, "eta": 0.2})


def test_evaluate_takes_the_same_word_and_records_it() -> None:
    made = ready("simple", {"preset": "as_printed", "budget": ppl.simulations(30)})
    predict: Any = made.predict
    assert predict.options["settings"] == PRINTED
    assert (predict.options["rule"], predict.options["weights"]) == ("paper", "count")
    assert "iterations" not in predict.options
    assert predict.model.planner_config() == ppl.PlannerConfig().as_printed()
    assert made.record["options"]["preset"] == "as_printed"
    own: Any = ready("simple", {"preset": "as_printed", "simulator": walkers}).predict
    assert own.model.planner is None


def test_lesions_plan_as_the_preset_does() -> None:
    lesion: Any = ready("no_cost_weight", {"preset": "as_printed"}).predict
    config = lesion.model.planner_config()
    assert (config.simulations, config.cost_weight, config.swivel) == (1000, 0.0, False)
    assert lesion.options["rule"] == "paper"


def test_predicates_as_printed_have_a_uniform_prior_and_the_planners_thresholds() -> None:
    kept = ready("predicate", {"preset": "as_printed"}).record["model_settings"]
    usual = PredicateSettings()
    assert kept["prior"] == INDEPENDENT
    for name in ("on_agent", "on_item", "touch_item"):
        assert kept[name] == pytest.approx(getattr(usual, name) / 3)
    changed = ready("predicate", {"preset": "as_intended", "prior": "uniform", "on_item": 2.0})
    assert changed.record["model_settings"]["prior"] == "uniform"
    assert changed.record["model_settings"]["on_item"] == 2.0


def test_open_settings_are_settled_by_the_world_alone() -> None:
    solo = ppl.worlds.SOLO
    event = ppl.simulate(solo.random_scene(0), goals={"red agent": "get to ball"}, frames=3)

    def settled(event: ppl.Event, model: ppl.Model, kernel: str) -> tuple[Any, Any]:
        found = Run(event, model, kernel, {}, ppl.SimpleSettings(), 2, 0).settings
        return found.proposal, found.strength

    noisy = ppl.Model(simulator=ppl.JointSimulator(noise=DynamicsNoise()))
    for kernel in ("local_mh", "prior_mh"):
        assert settled(event, ppl.Model(), kernel) == ("paper", "analytic")
        for model in (ppl.Model(), ppl.Model(simulator=walkers), noisy):
            assert settled(walking_event(), model, kernel) == ("learned", "network")


def test_infer_takes_single_settings_and_writes_the_word_down(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    asked: list[dict[str, Any]] = []

    @functools.wraps(ppl.infer)
    def remembered(event: Any, model: Any, **given: Any) -> Any:
        asked.append(given)
        raise InvalidSettingError("enough")

    with monkeypatch.context() as patch:
        patch.setattr(ppl, "infer", remembered)
        command = ["infer", "collaborate", "--preset", "as_printed", "--option", "eta=0.2"]
        assert main([*command, "--planner", "fast", "--quiet"]) == 2
        assert asked[0]["settings"].eta == 0.2
        assert asked[0]["settings"].sign == "printed"
        assert (asked[0]["planner"], asked[0]["rule"]) == ("fast", "paper")
        assert main(["infer", "collaborate", "--preset", "printed"]) == 2
        assert "unknown preset 'printed'" in capsys.readouterr().err
    walk, out = tmp_path / "walk.json", tmp_path / "out"
    ppl.save_event(walking_event(5), walk)
    options = "--preset as_intended --planner fast --chains 4 --iterations 1 --kernel prior_mh"
    more = "--workers 1 --weights count --quiet --out"
    assert main(["infer", str(walk), *options.split(), *more.split(), str(out)]) == 0
    assert json.loads((out / "summary.json").read_text())["preset"] == "as_intended"
