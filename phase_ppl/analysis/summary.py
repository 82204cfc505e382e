"""A posterior in short: as plain data for a file, and as a table for a terminal."""

from __future__ import annotations

import textwrap
from collections.abc import Iterator, Mapping, Sequence
from typing import TYPE_CHECKING, Any, Final

import numpy as np

from phase_ppl.world.names import AGENTS

if TYPE_CHECKING:
    from phase_ppl.analysis.hypotheses import Hypotheses
    from phase_ppl.analysis.posterior import Posterior

WIDTH: Final = 88
"""Columns of the table."""

LABEL: Final = 13
"""Columns of what stands before a line."""

_NAME, _NUMBER, _BAR = 36, 16, 22
_GOALS: Final = dict(zip(AGENTS, ("goal_red", "goal_green"), strict=True))
_STRENGTHS: Final = dict(zip(AGENTS, ("strength_red", "strength_green"), strict=True))


def summary(post: Posterior) -> dict[str, Any]:
    """Return ``post`` in JSON's types; numbers that do not exist are None.

    Keys: ``goals`` (agent -> all 36 goals), ``relation``, ``scenario``, ``strengths`` (agent ->
    mean, sd, hdi_low, hdi_high in newtons), ``errors`` (of each of these, in the same form),
    ``map``, ``diagnostics``, ``settings``, ``cost``.
    """
    record = {
        **answers(post),
        "map": post.map_record(),
        "diagnostics": post.diagnostics(),
        "settings": post.settings,
        "cost": post.cost,
    }
    return {name: plain(value) for name, value in record.items()}


def answers(post: Hypotheses) -> dict[str, Any]:
    """Return the part of a summary that every table of hypotheses has."""
    marginals = {name: post.marginal(name) for name in (*_GOALS.values(), "relation", "scenario")}
    numbers = {agent: _numbers(post, name) for agent, name in _STRENGTHS.items()}

    def of(part: int) -> dict[str, Any]:
        """Return the values, or their errors."""
        tables = {
            name: dict(
                zip(
                    found[name].values.tolist(),
                    (found["error"] if part else found).values.tolist(),
                    strict=True,
                )
            )
            for name, found in marginals.items()
        }
        return {
            "goals": {agent: tables[name] for agent, name in _GOALS.items()},
            "relation": tables["relation"],
            "scenario": tables["scenario"],
            "strengths": {
                agent: {key: pair[part] for key, pair in found.items()}
                for agent, found in numbers.items()
            },
        }

    return {**of(0), "errors": of(1)}


def _numbers(post: Hypotheses, name: str) -> dict[str, tuple[float, float]]:
    """Return mean, standard deviation and interval of a strength, each with its error."""
    mean, sd, interval = post.mean(name), post.sd(name), post.hdi(name)
    (low, high), (low_error, high_error) = interval.values, interval["error"].values
    return {
        "mean": (float(mean), mean.error),
        "sd": (float(sd), sd.error),
        "hdi_low": (low, low_error),
        "hdi_high": (high, high_error),
    }


def plain(value: Any) -> Any:
    """Return ``value`` in JSON's types; numbers that are not finite become None."""
    if isinstance(value, Mapping):
        return {str(key): plain(entry) for key, entry in value.items()}
    if isinstance(value, list | tuple):
        return [plain(entry) for entry in value]
    if isinstance(value, np.ndarray | np.generic):
        return plain(value.tolist())
    if isinstance(value, float):
        return float(value) if np.isfinite(value) else None
    return value


def table(post: Posterior) -> str:
    """Return ``post`` as a table of at most 88 columns."""
    found = post.diagnostics()
    head = (
        f"{found['particles']} particles x {found['iterations']} iterations, "
        f"{found['kernel']}, weights {found['weights']}"
    )
    if post.burn_in and post.weights == "count":
        head += f", after a burn-in of {post.burn_in}"
    lines = [*wrapped("posterior", f"{post.event_id}: {head}")]
    lines += [*wrapped("verdict", found["verdict"]), "", *answer_lines(post)]
    lines += ["", *wrapped("fit", _fit(found)), *wrapped("cost", _cost(post.cost, found))]
    return "\n".join(lines)


def answer_lines(post: Hypotheses) -> list[str]:
    """Return the lines about goals, relation, scenario and strengths."""
    lines: list[str] = []
    for agent, name in _GOALS.items():
        lines += _bars(agent, [entry for entry in post.top(name, 3) if entry[1] > 0])
    lines += _bars("relation", post.top("relation", 3))
    lines += _bars("scenario", post.top("scenario", 4))
    for agent, name in _STRENGTHS.items():
        low, high = post.hdi(name).values
        text = f"{agent}: {post.mean(name)} N (94 % interval {low:.0f} to {high:.0f} N)"
        lines.append(f"{'strength' if agent == AGENTS[0] else '':<{LABEL}}{text}")
    return lines


def _bars(label: str, entries: Sequence[tuple[str, float]]) -> Iterator[str]:
    for name, probability in entries:
        bar = "#" * round(probability * _BAR)
        yield f"{label:<{LABEL}}{name:<{_NAME}}{probability!s:<{_NUMBER}}{bar}".rstrip()
        label = ""


def _fit(found: Mapping[str, Any]) -> str:
    return (
        f"the best draw stays {found['best_error_per_frame']:.2f} units per frame from the "
        "observation (all four entities together)"
    )


def _cost(cost: Mapping[str, Any], found: Mapping[str, Any]) -> str:
    simulations = found["simulations"]
    words = f"{simulations['total']} simulations"
    if isinstance(cost.get("frames"), int):
        words += f", {cost['frames']} frames"
    if cost.get("budget"):
        words += f" (of a budget of {cost['budget']}),"
    if isinstance(cost.get("seconds"), int | float):
        words += f" in {cost['seconds']:.0f} s"
    if isinstance(cost.get("workers"), int):
        words += f" on {cost['workers']} worker{'' if cost['workers'] == 1 else 's'}"
    if isinstance(cost.get("seconds_overhead"), int | float):
        words += f", {cost['seconds_overhead']:.0f} s of it beside the simulations"
    if simulations["aborted"]:
        words += (
            f"; {simulations['aborted']} stopped early, which saved "
            f"{found['frames_saved_share']:.0%} of the frames"
        )
    else:
        words += "; none stopped early"
    words += f"; {cost.get('failures', simulations['failed'])} failed"
    return f"{words}, {cost['retries']} run again" if cost.get("retries") else words


def wrapped(label: str, text: str) -> list[str]:
    """Return ``text`` as lines of a table, the first of which begins with the label."""
    indent = " " * LABEL
    return textwrap.wrap(text, WIDTH, initial_indent=f"{label:<{LABEL}}", subsequent_indent=indent)
