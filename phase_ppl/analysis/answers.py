"""What a table of hypotheses says of goals, relations, scenario and strengths, all at once."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import Any

from phase_ppl.analysis.estimate import Estimate
from phase_ppl.analysis.hypotheses import Hypotheses, with_errors
from phase_ppl.world.picture import bars, wrapped


def answers(of: Hypotheses) -> dict[str, Any]:
    """Return ``goals``, relations, scenario and ``strengths``, and the ``errors`` of each."""
    goals = {agent: dict(with_errors(of.marginal(name))) for agent, name in of.goals_of.items()}
    found: dict[str, Any] = {"goals": goals}
    for name in (*of.relations_of.values(), *of.scenarios_of.values()):
        found[name] = dict(with_errors(of.marginal(name)))
    found["strengths"] = {}
    for agent, name in of.strengths_of.items():
        (_, low), (_, high) = with_errors(of.hdi(name))
        numbers = {"mean": of.mean(name), "sd": of.sd(name)}
        found["strengths"][agent] = {**numbers, "hdi_low": low, "hdi_high": high}
    return {**_of_each(found, float), "errors": _of_each(found, lambda one: one.error)}


def answer_lines(
    of: Hypotheses,
    untried: Callable[[str], frozenset[str]] = lambda name: frozenset(),
    levels: Sequence[float] = (),
) -> list[str]:
    """Return the lines of a table about goals, relations, scenario and strengths.

    ``untried`` returns the labels of a quantity that nothing was simulated for. ``levels`` are the
    only strengths that there are, newtons; none: any.
    """
    lines: list[str] = []
    for agent, name in of.goals_of.items():
        lines += bars(agent, [entry for entry in of.top(name, 3) if entry[1] > 0])
    for label, name in (*of.relations_of.items(), *of.scenarios_of.items()):
        without = untried(name)
        lines += bars(label, [(one, None if one in without else p) for one, p in of.top(name, 4)])
    for place, (agent, name) in enumerate(of.strengths_of.items()):
        if levels:
            events: list[dict[str, Any]] = [{name: (level, level)} for level in levels]
            shares = [of.probability(**event) for event in events]
            text = ", ".join(f"{x:g} N {p:.2f}" for x, p in zip(levels, shares, strict=True))
        else:
            low, high = of.hdi(name).values
            text = f"{of.mean(name)} N (94 % interval {low:.0f} to {high:.0f} N)"
        lines += wrapped("" if place else "strength", f"{agent}: {text}")
    return lines


def _of_each(found: Mapping[str, Any], part: Callable[[Estimate], float]) -> dict[str, Any]:
    """Return a part of every estimate in nested dictionaries."""
    return {
        name: _of_each(one, part) if isinstance(one, dict) else part(one)
        for name, one in found.items()
    }
