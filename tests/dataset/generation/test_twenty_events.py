"""Twenty events with the fast planner, from the terminal to a model's score."""

from __future__ import annotations

from collections import Counter
from pathlib import Path

import phase_ppl as ppl
from phase_ppl.cli import main
from phase_ppl.dataset.generation.plan import PHASE500, scaled
from phase_ppl.world.geometry import is_on
from phase_ppl.world.goals import goal_literal
from phase_ppl.world.names import Predicate


def test_twenty_events_show_what_they_should(tmp_path: Path) -> None:
    out = tmp_path / "set"
    arguments = ["generate", "--n", "20", "--seed", "7", "--planner", "fast", "--quiet"]
    assert main([*arguments, "--workers", "1", "--out", str(out)]) == 0
    assert main(["verify", str(out)]) == 0
    made = ppl.load_events(out)
    assert isinstance(made, ppl.GeneratedEvents)
    cells = {cell: n for cell, n in scaled(PHASE500, 20).items() if n}
    assert {cell: n for cell, n in made.manifest["kept"].items() if n} == cells
    assert Counter(entry["split"] for entry in made.entries) == {
        "train": 13, "validation": 3, "test": 4,
    }  # fmt: skip
    for event, entry in zip(made, made.entries, strict=True):
        assert event.truth is not None
        assert event.truth.relation == entry["relation"]
        if entry["relation"] == "adversarial":
            continue
        # whoever helps or minds its own business has reached its goal, and not from the start
        first, last = event.observation.trajectory[[0, -1]]
        for agent, goal in enumerate((event.truth.goal_red, event.truth.goal_green)):
            literal = goal_literal(goal, agent)
            assert literal.predicate is Predicate.ON
            centre = event.scene.landmark_centres[literal.target]
            half = event.scene.landmark_half_width
            assert is_on(last[literal.subject, :2], centre, half)
            assert not is_on(first[literal.subject, :2], centre, half)
    found = ppl.evaluate(made, "last_frame", workers=1, progress=False)
    assert found.metrics["n_events"] == 20
    goals = found.metrics["by_scenario"]["collaborative"]["goal_accuracy"]["value"]
    assert goals > 1 / 36
