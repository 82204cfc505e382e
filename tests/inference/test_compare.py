"""Kernels side by side on a toy: equal budgets, repeats, reference, checkpoint, Ctrl-C."""

from __future__ import annotations

import dataclasses
import itertools
import re
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pytest

import phase_ppl as ppl
from phase_ppl.analysis.comparison import distances
from phase_ppl.inference.compare import Entry, entries
from phase_ppl.inference.kernels.metropolis import PriorMH
from phase_ppl.inference.reference import (
    Reference,
    enumerate_goals,
    error_of,
    of_goals,
    of_masses,
    plan_enumeration,
    reference_of,
)
from phase_ppl.models.likelihood import RadialLikelihood
from phase_ppl.models.sites import SELF_REFERRING
from phase_ppl.world.errors import InvalidEventError, InvalidSettingError, UnknownNameError
from phase_ppl.world.hypothesis import RELATION_TABLE, RELATIONS, Hypothesis
from phase_ppl.world.scene import Scene
from tests.inference.runs import EVENT, MODEL, infer
from tests.inference.toy import all_of_few_goals, few_goals, never_called, walkers, walking_event

KERNELS = {"early": "prior_mh", "whole": ("prior_mh", {"early_reject": False})}
SETTINGS: dict[str, Any] = {
    "kernels": KERNELS,
    "budget": ppl.simulations(24),
    "repeats": 2,
    "chains": 4,
    "seed": 5,
    "workers": 1,
    "progress": False,
}


@pytest.fixture(scope="module")
def reference() -> ppl.Posterior:
    return infer(iterations=5, seed=0)


def compare(reference: Any, **options: Any) -> ppl.Comparison:
    return ppl.compare(EVENT, MODEL, **{**SETTINGS, "reference": reference, **options})


@pytest.fixture(scope="module")
def found(reference: ppl.Posterior) -> ppl.Comparison:
    return compare(reference)


def assert_same_runs(one: ppl.Comparison, other: ppl.Comparison) -> None:
    for table in ("runs", "curve"):
        untimed = [getattr(each, table).filter(regex="^(?!.*second)") for each in (one, other)]
        pd.testing.assert_frame_equal(*untimed)


def test_every_kernel_runs_every_repeat_within_the_budget(found: ppl.Comparison) -> None:
    expected = list(itertools.product(KERNELS, range(2)))
    assert list(zip(found.runs["kernel"], found.runs["repeat"], strict=True)) == expected
    assert (found.runs["simulations"] == 24).all()
    assert (found.runs["validity"] == "exact").all()
    # repeats have seeds of their own that the kernels share
    seeds = found.runs.pivot(index="repeat", columns="kernel", values="seed")
    assert (seeds["early"] == seeds["whole"]).all()
    assert seeds["early"].nunique() == 2
    assert all(words in str(found) for words in ("early", "TV goals", "the budget of simulations"))
    assert found.settings["budget"] == "24 simulations"
    assert found.settings["kernels"]["whole"]["options"] == {"early_reject": False}
    assert "given posterior" in found.settings["reference"]["description"]
    # they make the same draws, and so measure the same
    same = found.runs.drop(columns=["kernel", "seconds", "ess_per_second", "frames"])
    one, other = (same[found.runs["kernel"] == name].reset_index(drop=True) for name in KERNELS)
    assert one.equals(other)
    assert one["tv_goals"].between(0, 1).all()
    frames = found.runs.groupby("kernel")["frames"].sum()
    assert frames["early"] < frames["whole"] == 2 * 24 * 14


def test_a_run_can_be_made_again_by_infer(found: ppl.Comparison, reference: ppl.Posterior) -> None:
    run = found.runs.iloc[1]
    post = infer(iterations=None, budget=ppl.simulations(24), seed=int(run["seed"]))
    post = ppl.Posterior(post.tree, "count")
    assert run["p_relation"] == post.probability(relation=EVENT.truth.relation)
    apart = [
        0.5 * np.abs(post.marginal(name).values - reference.marginal(name).values).sum()
        for name in ("goal_red", "goal_green")
    ]
    assert run["tv_goals"] == pytest.approx(np.mean(apart))
    ends = found.curve.groupby(["kernel", "repeat"]).tail(1).reset_index(drop=True)
    for name in ("tv_goals", "p_goals", "map_relation", "simulations", "frames"):
        np.testing.assert_allclose(ends[name], found.runs[name])
    counts = found.curve.groupby(["kernel", "repeat"])["simulations"].apply(list)
    assert counts.iloc[0] == [8, 12, 16, 20, 24]


def test_an_event_needs_no_truth(
    reference: ppl.Posterior, found: ppl.Comparison, capsys: pytest.CaptureFixture[str]
) -> None:
    event = dataclasses.replace(EVENT, truth=None)
    few = {"reference": reference, "repeats": 1, "kernels": ["prior_mh"], "progress": True}
    other = ppl.compare(event, MODEL, **{**SETTINGS, **few})
    assert other.runs["tv_goals"][0] == found.runs["tv_goals"][0]
    assert other.runs["p_goals"].isna().all()
    assert "P(goals)" not in str(other)
    written = capsys.readouterr()
    assert "2/2" in written.err, "it counts runs"
    assert written.out == ""


def asked(given: Any) -> Reference:
    return Reference.asked_for(given, EVENT, SETTINGS["budget"])


def test_by_default_goals_are_enumerated_where_that_takes_ten_budgets_at_most() -> None:
    assert asked(None).record() == {"enumeration within": "240 simulations"}
    found = compare(None, repeats=1, kernels=["prior_mh"]).settings["reference"]
    assert found["description"] == "none"  # PHASE's take 4624


def test_without_a_reference_there_are_no_distances_and_no_ranks() -> None:
    found = compare("none")
    assert found.runs["tv_goals"].isna().all()
    assert (found.runs["p_goals"] >= 0).all()
    assert "reference: none\nso there are no distances, and no ranks" in str(found)
    assert "rank by" not in str(found)


def in_place_of_infer(monkeypatch: pytest.MonkeyPatch, infer: Any) -> None:
    monkeypatch.setitem(Entry.run.__globals__, "infer", infer)  # ``compare`` names the function too


def test_a_preset_is_run_whole_and_kept_whole(
    monkeypatch: pytest.MonkeyPatch, reference: ppl.Posterior
) -> None:
    seen: list[dict[str, Any]] = []

    def infer(event: Any, model: Any, **given: Any) -> ppl.Posterior:
        seen.append(given)
        return reference

    in_place_of_infer(monkeypatch, infer)
    monkeypatch.setattr(Entry, "check", lambda *_: None)
    kernels = {"printed": "as_printed", "guided": "guided", "prior": "prior_mh"}
    found = ppl.compare(
        EVENT, **{**SETTINGS, "kernels": kernels, "reference": "none", "repeats": 1}
    )
    printed, guided, prior = seen
    preset = ppl.preset("as_printed")
    assert preset.pop("weights") == "count"  # of the posterior that is made of it
    assert preset.items() <= printed.items()
    assert printed["budget"] is None
    assert ppl.preset("guided").items() <= guided.items()
    assert guided["budget"] == prior["budget"] == SETTINGS["budget"]
    kept = found.settings["kernels"]["printed"]
    assert (kept["chains"], kept["options"]) == (15, {"rule": "paper"})
    assert kept["settings"]["sign"] == "printed"
    assert (kept["iterations"], kept["planner"]) == ("6", "as_printed")
    assert found.settings["proposals"] == {
        "printed": "paper",
        "guided": "closed_loop",
        "prior": None,
    }
    rows = r"proposals .*\nprinted +paper .*\nguided +closed_loop .*\nprior +- "
    assert re.search(rows, str(found))
    assert "other lengths: printed, which has 6 iterations" in str(found)


def counted(monkeypatch: pytest.MonkeyPatch, stop_at: int | None = None) -> list[str]:
    """Return a list to which every run adds its kernel; the user interrupts one of them."""
    calls: list[str] = []

    def infer(*args: Any, **options: Any) -> ppl.Posterior:
        if len(calls) == stop_at:
            raise ppl.Interrupted(None)
        calls.append(options["kernel"])
        return ppl.infer(*args, **options)

    in_place_of_infer(monkeypatch, infer)
    return calls


def test_interrupt_keeps_finished_runs_and_a_checkpoint_goes_on_from_them(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path, reference: ppl.Posterior, found: ppl.Comparison
) -> None:
    path = tmp_path / "runs.json"
    counted(monkeypatch, stop_at=0)
    with pytest.raises(ppl.ComparisonInterrupted) as caught:
        compare(reference, checkpoint=path)
    assert caught.value.comparison is None
    counted(monkeypatch)
    compare(reference, checkpoint=path, repeats=1, kernels={"early": "prior_mh"})
    counted(monkeypatch, stop_at=2)
    with pytest.raises(ppl.ComparisonInterrupted) as caught:
        compare(reference, checkpoint=path)  # more repeats and kernels than at first
    kept = caught.value.comparison
    # repeat by repeat, so that what is kept is balanced
    finished = [("early", 0), ("early", 1), ("whole", 0)]
    assert list(zip(kept.runs["kernel"], kept.runs["repeat"], strict=True)) == finished
    assert len(ppl.Comparison.load(path).runs) == 3
    calls = counted(monkeypatch)
    for _ in range(2):
        again = compare(reference, checkpoint=path)
        assert len(calls) == 1
    assert_same_runs(again, found)
    assert ppl.Comparison.load(path).runs.equals(again.runs)


def test_a_checkpoint_of_other_settings_or_damaged_is_refused(
    tmp_path: Path, found: ppl.Comparison, reference: ppl.Posterior
) -> None:
    path = found.save(tmp_path / "runs.json")
    changes: list[tuple[str, dict[str, Any]]] = [
        ("another seed", {"seed": 6}),
        ("another budget", {"budget": ppl.simulations(28)}),
        ("kernel 'early'", {"kernels": {"early": KERNELS["whole"]}}),
        ("another reference", {"reference": "none"}),
    ]
    for message, change in changes:
        with pytest.raises(InvalidSettingError, match=message):
            compare(**{"reference": reference, "checkpoint": path, **change})
    path.write_text('{"schema": "phase-ppl-comparison-1", "runs"')
    with pytest.raises(InvalidEventError, match="no comparison"):
        compare(reference, checkpoint=path)


def even_only(program: Any) -> Any:
    """A kernel that stumbles over an odd number of chains."""

    class EvenOnly(PriorMH):
        def init(self, rng_key: Any, *args: Any, **options: Any) -> Any:
            if len(rng_key) % 2:
                raise AssertionError("Number of chains must be even.")
            return super().init(rng_key, *args, **options)

    return EvenOnly(program)


REFUSED, UNKNOWN = InvalidSettingError, UnknownNameError
SPEED = ("prior_mh", {"speed": 3})
WRONG: list[tuple[dict[str, Any], type[Exception], str]] = [
    ({"kernels": ["prior_hm"]}, UNKNOWN, "prior_mh"),
    ({"kernels": ["prior_mh", "prior_mh"]}, REFUSED, "called 'prior_mh'"),
    ({"kernels": {"a": "prior_mh", "b": SPEED}}, REFUSED, "b: .*speed"),
    ({"kernels": {"pairs": even_only}, "chains": 5}, REFUSED, "pairs: .*5 chains.*must be even"),
    ({"budget": ppl.simulations(7)}, REFUSED, "early: .*too small"),
    ({"budget": 24}, REFUSED, "budget=24"),
    ({"kernels": {"a": ("prior_mh", {"seed": 3})}}, REFUSED, "same for all"),
    ({"reference": "prior_mh"}, REFUSED, "reference='prior_mh', expected 'enumeration'"),
    ({"reference": ("enumeration", {"per_pair": 5})}, REFUSED, "per_pair=5, expected an even"),
    ({"checkpoint": "runs.nc"}, OSError, r"\.json"),
]


@pytest.mark.parametrize(("wrong", "error", "message"), WRONG)
def test_what_cannot_run_is_refused_before_anything_is_simulated(
    wrong: dict[str, Any], error: type[Exception], message: str
) -> None:
    model = ppl.Model(simulator=never_called)
    with pytest.raises(error, match=message):
        ppl.compare(EVENT, model, **{**SETTINGS, "reference": "none", **wrong})


def test_chains_may_be_ones_own(reference: ppl.Posterior) -> None:
    with pytest.raises(InvalidEventError, match="another event"):
        ppl.compare(walking_event(9), MODEL, **{**SETTINGS, "reference": reference})
    (pairs,) = entries({"pairs": (even_only, {"chains": 6})}, 5, ppl.SimpleSettings())
    pairs.check(EVENT, MODEL, ppl.simulations(24))
    assert pairs.record()["chains"] == 6


def straight(scene: Scene, hypothesis: Hypothesis, rng: np.random.Generator) -> Iterator[Any]:
    """``walkers`` without chance, all agents alike."""
    forces = {"strength_red": 400.0, "strength_green": 400.0}
    alike = Hypothesis.from_dict({**hypothesis.to_dict(), **forces})
    return walkers(scene, alike, np.random.default_rng(0))


def exact_pairs() -> np.ndarray:
    """The posterior of the effective goals under ``few_goals`` and ``straight``."""
    mass = np.zeros((36, 36))
    observed = EVENT.observation.positions
    for prior, h in all_of_few_goals():
        frames = itertools.islice(straight(EVENT.scene, h, np.random.default_rng(0)), len(observed))
        off = np.array(list(frames))[..., :2] - observed
        errors = np.linalg.norm(off.reshape(len(observed), -1), axis=1)
        mass[h.effective_goals] += prior * np.exp(-RadialLikelihood().beta * errors.sum())
    return mass / mass.sum()


def test_affordable_enumeration_is_exact_and_the_default_reference() -> None:
    exact = exact_pairs()
    model = ppl.Model(prior=few_goals, simulator=straight)
    plan = plan_enumeration(model)
    assert len(plan.goals) == np.count_nonzero(exact)
    found = enumerate_goals(EVENT, model, plan, workers=1)
    np.testing.assert_allclose(found.probability, exact, atol=1e-4)
    np.testing.assert_allclose(found.halves[:, 0], found.halves[:, 1], atol=1e-6)
    assert found.simulations == 4 * len(plan.goals)
    reference = reference_of(asked(None), EVENT, model, None, seed=0, workers=1)
    assert reference["description"].startswith("enumeration of")
    for name, expected in of_goals(exact).items():
        np.testing.assert_allclose(reference["marginals"][name], expected, atol=1e-4)
    more = asked(("enumeration", {"per_pair": 6}))
    by_chance = dataclasses.replace(model, simulator=walkers)
    reference = reference_of(more, EVENT, by_chance, None, seed=0, workers=1)
    assert "6 simulations each" in reference["description"]
    assert reference["simulations"] == 6 * len(plan.goals)
    assert 0 < reference["error"]["tv_goals"] < 1
    friendly = exact[RELATIONS.index("friendly") == RELATION_TABLE].sum()
    assert of_goals(exact)["relation"][RELATIONS.index("friendly")] == pytest.approx(friendly)


@pytest.mark.parametrize("sd", [0.3, 5.8])
def test_a_reference_says_how_far_it_may_be_off(sd: float) -> None:
    pairs = np.argwhere(~SELF_REFERRING[0][:, None] & ~SELF_REFERRING[1][None, :])
    rng = np.random.default_rng(4)
    true, stated = [], []
    for _ in range(40):
        level = rng.normal(0, 4, (2, 36))
        log_mass = level[0, pairs[:, 0]] + level[1, pairs[:, 1]] + rng.normal(0, 1, len(pairs))
        exact = np.zeros((36, 36))
        exact[tuple(pairs.T)] = np.exp(log_mass - log_mass.max())
        exact /= exact.sum()
        # as four simulations with so much noise have them
        found = of_masses(pairs, log_mass[:, None] + rng.normal(0, sd, (len(pairs), 4)))
        error = error_of([(of_goals(one), of_goals(other)) for one, other in found.halves])
        true.append(distances(of_goals(found.probability), of_goals(exact))["tv_goals"])
        stated.append(error["tv_goals"])
    assert np.mean(np.less(true, stated)) >= 0.7
    assert np.mean(true) < np.mean(stated) < 2.5 * np.mean(true)
