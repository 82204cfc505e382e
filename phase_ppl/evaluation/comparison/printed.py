"""A comparison of models as tables for a terminal, of at most 100 columns."""

from __future__ import annotations

import textwrap
from collections.abc import Callable, Iterator, Mapping, Sequence
from typing import TYPE_CHECKING, Any, Final

from phase_ppl.evaluation.bootstrap import LEVEL
from phase_ppl.evaluation.comparison.statistics import LEAST_EVENTS
from phase_ppl.evaluation.curves import at
from phase_ppl.evaluation.observers import PEOPLE
from phase_ppl.world.relations import SCENARIOS

if TYPE_CHECKING:
    from phase_ppl.evaluation.comparison.comparison import ModelComparison

WIDTH: Final = 100
PAIRS: Final = 15
"""Pairs of models that are printed at most; of more, those with the first model."""

MAJORITY: Final = "people, majority"

_LABEL: Final = 24
_NAME: Final = 19
_NOTHING: Final = "-"
_EVENTS: Final = "events"
_KINDS: Final = {"goal": "goals", "relation": "relations"}
_DIFFERENCES: Final = {
    "right answers": "accuracy",
    "the log probability of the true answer, nats": "log_score_truth",
}

Row = tuple[str, Mapping[str, Any]]
Column = tuple[str, Callable[[Mapping[str, Any]], str]]


def comparison_text(c: ModelComparison) -> str:
    """Return all tables of a comparison."""
    judged = c.people["n_events"]
    head = f"{_number(len(c.models), 'model')} on {_number(len(c.events), 'event')}"
    if judged:
        head += f", {judged} of them with truth and people's judgments"
    lines = _wrapped(
        f"{head}; intervals of {LEVEL:.0%}: of right answers Clopper-Pearson, of the rest from "
        "resampled events"
    )
    for note in c.notes:
        lines += _wrapped(f"note: {note}")
    for title, columns, rows in _tables(c):
        lines += _table(title, columns, rows)
    lines += _differences(c)
    lines += _equivalence(c)
    return "\n".join(lines)


def _tables(c: ModelComparison) -> Iterator[tuple[str, list[Column], list[Row]]]:
    models: list[Row] = [(name, c.metrics[name]) for name in c.models]
    right: list[Row] = [*models, (PEOPLE, c.people), (MAJORITY, c.people["majority"])]
    yield (
        "right answers (people: share of people who are right)",
        [
            ("goals", _interval("goal_accuracy")),
            ("goal in top 3", _interval("goal_top3_accuracy")),
            ("relations", _interval("relation_accuracy")),
            (_EVENTS, lambda metrics: str(metrics.get("n_events", ""))),
            ("CPU s/event", _seconds),
        ],
        right,
    )
    counts = {name: max(m["by_scenario"][name]["n"] for _, m in models) for name in SCENARIOS}
    for kind, word in _KINDS.items():
        yield (
            f"{word} right, by true scenario (events)",
            [
                (f"{name} ({counts[name]})", _interval(f"by_scenario.{name}.{kind}_accuracy"))
                for name in SCENARIOS
                if counts[name]
            ],
            right,
        )
    yield (
        "mean log probability of the true answer, nats",
        [(word, _interval(f"{kind}_log_score_truth")) for kind, word in _KINDS.items()],
        models,
    )
    among = _among_people(models)
    for kind, word in _KINDS.items():
        prefix = "goal_" if kind == "goal" else ""
        columns = [("r", _interval(f"human.{kind}_r"))]
        if kind == "relation":
            columns.append(("r given truth", _interval("human.relation_r_given_truth")))
        columns.append(("log score", _interval(f"human.{prefix}log_score")))
        columns.append(("JS divergence", _interval(f"human.{prefix}js")))
        yield (
            f"agreement with people on {word} (people: r of halves; bound of the log score)",
            columns,
            [*models, (PEOPLE, among)],
        )


def _among_people(models: Sequence[Row]) -> dict[str, Any]:
    """Return people's agreement with each other, in the places of models' with people.

    It is about the same events as a model's; of those that have it, the one with most events.
    """
    places = {
        "goal_r": "goal_split_half_r",
        "relation_r": "split_half_r",
        "goal_log_score": "goal_log_score_people",
        "log_score": "log_score_people",
    }
    by_events = sorted((m for _, m in models), key=lambda metrics: -metrics["n_events"])
    found = {
        place: next((m["human"][name] for m in by_events if m["human"][name]), None)
        for place, name in places.items()
    }
    return {"human": found}


def _table(title: str, columns: Sequence[Column], rows: Sequence[Row]) -> list[str]:
    """Return a table without rows and columns that have nothing to say."""
    cells = [[cell(metrics) for _, cell in columns] for _, metrics in rows]
    of_counts = [heading == _EVENTS for heading, _ in columns]
    kept = [
        (name, row)
        for (name, _), row in zip(rows, cells, strict=True)
        if any(cell and not count for cell, count in zip(row, of_counts, strict=True))
    ]
    used = [j for j in range(len(columns)) if any(row[j] for _, row in kept)]
    if not kept:
        return []
    widths = {j: max(len(columns[j][0]), *(len(row[j]) for _, row in kept)) + 2 for j in used}
    names = [short(name, _LABEL - 2) for name, _ in kept]
    lines = ["", title]
    while used:
        block: list[int] = []
        left = WIDTH - max(map(len, names))
        while used and widths[used[0]] <= left:
            block.append(used.pop(0))
            left -= widths[block[-1]]
        table = [["", *(columns[j][0] for j in block)]]
        table += [
            [name, *(row[j] or _NOTHING for j in block)]
            for name, (_, row) in zip(names, kept, strict=True)
            if any(row[j] for j in block)
        ]
        lines += _aligned(table)
    return lines


def _aligned(table: Sequence[Sequence[str]]) -> list[str]:
    widths = [max(len(row[j]) for row in table) for j in range(len(table[0]))]
    first, *others = widths
    return [
        "  ".join(
            [f"{row[0]:<{first}}", *(f"{v:>{w}}" for v, w in zip(row[1:], others, strict=True))]
        ).rstrip()
        for row in table
    ]


def _differences(c: ModelComparison) -> list[str]:
    """Return the tables of paired differences: in right answers, in log probabilities."""
    rows = [r for r in c.differences if r["scenario"] is None]
    found = {(r["one"], r["other"], r["measure"]): r for r in rows}
    lines, left_out = [], 0
    for title, measure in _DIFFERENCES.items():
        measures = [f"{kind}_{measure}" for kind in _KINDS]
        pairs = list(dict.fromkeys((one, other) for one, other, m in found if m in measures))
        if not pairs:
            continue
        if len(pairs) > PAIRS and c.settings["against"] is None:
            shown = [pair for pair in pairs if c.models[0] in pair]
            pairs, left_out = shown, max(left_out, len(pairs) - len(shown))
        table = [["one minus other", *(cell for word in _KINDS.values() for cell in (word, "p"))]]
        for one, other in pairs:
            cells = [f"{short(one)} - {short(other)}"]
            for name in measures:
                cells += _difference(found.get((one, other, name)))
            table.append(cells)
        lines += ["", f"paired differences in {title}", *_aligned(table)]
    if lines:
        lines += _wrapped("p: bootstrap, corrected by Holm over the pairs")
    if left_out:
        lines += _wrapped(
            f"{left_out} more pairs, all corrected together, are in comparison.json; --against "
            "NAME compares with one model alone"
        )
    return lines


def _difference(row: Mapping[str, Any] | None) -> list[str]:
    if row is None:
        return [_NOTHING, _NOTHING]
    text = f"{row['value']:+.2f}"
    if row["ci_low"] is not None:
        text += f" [{row['ci_low']:+.2f}, {row['ci_high']:+.2f}]"
    return [text, _p(row["p_holm"])]


def _equivalence(c: ModelComparison) -> list[str]:
    rows = [row for row in c.equivalence if row["scenario"] is None]
    if not rows:
        return []
    margin = c.settings["margin"]
    table = [["model minus people", "", "value", "90 %", "p equiv.", "p differ", "verdict"]]
    for row in rows:
        kind = row["measure"].removesuffix("_accuracy")
        between = _NOTHING if row["low"] is None else f"[{row['low']:+.2f}, {row['high']:+.2f}]"
        table.append(
            [
                short(row["model"], _LABEL),
                _KINDS[kind],
                f"{row['value']:+.2f}",
                between,
                _p(row["p_equivalent_holm"]),
                _p(row["p_holm"]),
                row["verdict"],
            ]
        )
    words = (
        f"Tested is a model's being right minus the share of people who are right, event by event. "
        f"Equivalent: both one-sided tests reject a difference of {margin:g} or more (p equiv.); "
        "higher, lower: there is one (p differ). Both corrected by Holm over the models; neither "
        f"shown: undecided. Fewer than {LEAST_EVENTS} events are not tested for equivalence. "
        "comparison.json has differences and equivalence by scenario too."
    )
    title = f"equivalence with people, margin {margin:g}"
    return ["", title, *_aligned(table), *_wrapped(words)]


def _interval(measure: str) -> Callable[[Mapping[str, Any]], str]:
    path = tuple(measure.split("."))

    def cell(metrics: Mapping[str, Any]) -> str:
        found = at(metrics, path)
        if found is None:
            return ""
        text = f"{found['value']:.2f}"
        if found["ci_low"] is not None:
            text += f" [{found['ci_low']:.2f}, {found['ci_high']:.2f}]"
        return text

    return cell


def _seconds(metrics: Mapping[str, Any]) -> str:
    found = metrics.get("cpu_seconds")
    if found is None:
        return ""
    value = found["value"]
    return f"{value:.3f}" if value < 1 else f"{value:.1f}" if value < 100 else f"{value:.0f}"


def _p(value: float | None) -> str:
    if value is None:
        return _NOTHING
    return "<0.001" if value < 0.001 else f"{value:.3f}"


def short(name: str, most: int = _NAME) -> str:
    """Return a name; of a long one both ends, as one of them tells it from others."""
    half = (most - 3) // 2
    return name if len(name) <= most else f"{name[: most - 3 - half]}...{name[-half:]}"


def _number(n: int, what: str) -> str:
    return f"{n} {what}" if n == 1 else f"{n} {what}s"


def _wrapped(text: str) -> list[str]:
    return textwrap.wrap(text, WIDTH, subsequent_indent="  ")
