"""Metrics and other values as text, for tables, pages and figures."""

from __future__ import annotations

import textwrap
from collections.abc import Iterable, Iterator, Mapping, Sequence
from typing import Any, Final, NamedTuple

import pandas as pd

from phase_ppl.evaluation.bootstrap import LEAST_EVENTS, LEVEL
from phase_ppl.evaluation.metrics import PREFIX, Place, at
from phase_ppl.evaluation.table import PEOPLE
from phase_ppl.world.hypothesis import SCENARIOS

NOTHING: Final = "-"  # in a terminal's table, in place of a missing number
WIDTH: Final = 100  # columns of a terminal
LINES: Final = 40  # of a terminal, about
MAJORITY: Final = "people, majority"
KIND_WORDS: Final[dict[str, str]] = {"goal": "goals", "relation": "relations"}
INTERVALS: Final = (
    f"{LEVEL:.0%} intervals: right answers by Clopper-Pearson, with n lowered, since answers to "
    "one event correlate; other scores by resampling events"
)

_LABEL, _OF_PAIR = 22, 19  # most characters of a name, alone and in a pair
_EVENTS: Final = "n_events"
_VERDICTS: Final = {
    "decided": "in decided events",
    "undecided": "in undecided events",
    "sure": "where the answer is sure",
}
"""Column -> which answers it is about."""

_Rows = Mapping[str, Mapping[str, Any]]  # name -> metrics
_Columns = Mapping[str, str | Place]  # heading -> place in the metrics, parts joined by dots


def measure_text(found: Mapping[str, Any] | None, signed: bool = False, digits: int = 2) -> str:
    """Return a measure with its interval for a terminal: "0.50 [0.40, 0.60]"."""
    if found is None:
        return NOTHING
    how = f"{'+' if signed else ''}.{digits}f"
    text = f"{found['value']:{how}}"
    if found["ci_low"] is not None:
        text += f" [{found['ci_low']:{how}}, {found['ci_high']:{how}}]"
    return text


def p_text(value: float | None) -> str:
    """Return a p-value for a terminal."""
    if value is None:
        return NOTHING
    return "<0.001" if value < 0.001 else f"{value:.3f}"


def lines_of(table: pd.DataFrame, width: int | None = WIDTH) -> list[str]:
    """Return the lines of a table of texts; columns beyond the width follow below."""
    lines = table.to_string(line_width=width).splitlines()
    return [line.rstrip(" \\") for line in lines if line.strip()]


class Table(NamedTuple):
    """A table of numbers as text, for a terminal or a page."""

    title: str
    cells: pd.DataFrame  # the index has the names, one or both of a pair
    note: str = ""  # printed below

    def lines(self) -> list[str]:
        """Return its lines for a terminal."""
        most = _LABEL if self.cells.index.nlevels == 1 else _OF_PAIR
        names = self.cells.index.to_frame().map(lambda name: _short(name, most))
        shown = self.cells.set_axis(names.agg(" - ".join, axis=1).tolist())
        heading = " minus ".join(filter(None, self.cells.index.names))
        shown = shown.rename_axis(columns=heading)
        return ["", self.title, *lines_of(shown), *wrapped(self.note)]


def on_screen(tables: Iterable[Table], most: int) -> list[str]:
    """Return the lines of the tables that fit, at least one; the last lines name the others."""
    most -= 3  # for these last lines
    lines: list[str] = []
    left_out = []
    for table in tables:
        more = table.lines()
        if lines and len(lines) + len(more) > most:
            left_out.append(table.title.partition(" (")[0])
        else:
            lines += more
    if left_out:
        lines += ["", *wrapped(f"not shown, but in .metrics and ppl.report: {'; '.join(left_out)}")]
    return lines


def _short(name: str, most: int) -> str:
    """Return a name, shortened in the middle: usually one end tells it from others."""
    return name if len(name) <= most else f"{name[: most // 2 - 1]}...{name[2 - most // 2 :]}"


def wrapped(text: str) -> list[str]:
    """Return the lines of a paragraph for a terminal."""
    return textwrap.wrap(text, WIDTH, subsequent_indent="  ")


def number(value: float | None) -> str:
    """Return a number as typeset text; a dash for None."""
    if value is None:
        return "\N{EN DASH}"
    return f"{round(value, 2) + 0.0:.2f}".replace("-", "\N{MINUS SIGN}")  # no sign of a zero


# --- tables of metrics ----------------------------------------------------------------------------


def metric_tables(models: _Rows, people: Mapping[str, Any]) -> Iterator[Table]:
    """Yield all tables of models' metrics, the most important first; below models come people.

    Rows, columns and tables without a number are left out.
    """
    for title, columns, rows in _tables(models, people):
        numbers = [heading for heading, place in columns.items() if place != _EVENTS]
        cells = pd.DataFrame(
            {name: [_cell(m, place) for m in rows.values()] for name, place in columns.items()},
            list(rows),
        )
        known = cells != NOTHING
        kept = known[numbers].any(axis=1)
        if kept.any():
            yield Table(title, cells.loc[kept, known[kept].any()])


def _tables(models: _Rows, people: Mapping[str, Any]) -> Iterator[tuple[str, _Columns, _Rows]]:
    """Yield titles, columns and rows of tables."""
    right, title = models, "right answers"
    if people["n_events"]:
        right = {**models, PEOPLE: people, MAJORITY: people["majority"]}
        title += " (people: share of people who are right)"
    numbers = {"goals": "goal_accuracy", "goal in top 3": "goal_top3_accuracy"}
    numbers |= {"relations": "relation_accuracy", "events": _EVENTS, "CPU s/event": "cpu_seconds"}
    yield title, numbers, right
    for kind, word in KIND_WORDS.items():
        places: dict[str, Place] = {name: ("verdict", kind, name) for name in _VERDICTS}
        known = [
            words
            for name, words in _VERDICTS.items()
            if any(at(metrics, places[name]) for metrics in models.values())
        ]
        yield f"{word} right {', '.join(known)}", places, models
    agreeing = {**models, PEOPLE: _among_people(models)}
    for where, words in (
        ("human", " (people: r of halves; bound of the log score)"),
        ("moments", ", at moments of the film"),
    ):
        for kind, word in KIND_WORDS.items():
            prefix = PREFIX[kind]
            columns = {
                "r": f"{where}.{kind}_r",
                "r given truth": f"{where}.{kind}_r_given_truth",
                "log score": f"{where}.{prefix}log_score",
                "JS divergence": f"{where}.{prefix}js",
                "ECE": f"{where}.{prefix}ece",
            }
            yield f"agreement with people on {word}{words}", columns, agreeing
    for kind, word in KIND_WORDS.items():
        title, places = _by_part([*models.values()], kind)
        yield (
            f"{word} right, {title}",
            {name: (*place, f"{kind}_accuracy") for name, place in places.items()},
            right,
        )
    truth = {word: f"{kind}_log_score_truth" for kind, word in KIND_WORDS.items()}
    yield "mean log probability of the true answer, nats", truth, models
    doubts = {"r": "relation_r", "r given truth": "relation_r_given_truth"}
    doubts |= {"log score gap": "log_score_gap", "Brier": "brier", "ECE": "ece"}
    yield (
        "doubt about relations (people: r of one with the rest)",
        {heading: ("doubt", name) for heading, name in doubts.items()},
        agreeing,
    )


def _by_part(metrics: Sequence[Mapping[str, Any]], kind: str) -> tuple[str, dict[str, Place]]:
    """Return how answers are grouped, and heading -> its place in the metrics.

    In PHASE they are grouped by scenario; elsewhere goals by agent, relations by pair.
    """
    parts = "by_agent" if kind == "goal" else "by_pair"
    if not any("by_scenario" in of_model for of_model in metrics):
        names = dict.fromkeys(name for of_model in metrics for name in of_model.get(parts, ()))
        return parts.replace("_", " "), {name: (parts, name) for name in names}
    counts = {name: max(m["by_scenario"][name]["n"] for m in metrics) for name in SCENARIOS}
    places: dict[str, Place] = {
        f"{name} ({n})": ("by_scenario", name) for name, n in counts.items() if n
    }
    return "by true scenario (events)", places


def _among_people(models: _Rows) -> dict[str, Any]:
    """Return people's agreement with each other, in the places of models' agreement with people.

    It is taken from the metrics of the model with the most events, and is about these events.
    """
    by_events = sorted(models.values(), key=lambda metrics: -metrics["n_events"])

    def first(path: str) -> Any:
        return next(filter(None, (at(metrics, path) for metrics in by_events)), None)

    doubt = {f"relation_{r}": first(f"doubt.ceiling.one_out_{r}") for r in ("r", "r_given_truth")}
    human, moments = {}, {}
    for kind, prefix in PREFIX.items():
        moments[f"{kind}_r"] = first(f"moments.{prefix}split_half_r")
        moments[f"{prefix}log_score"] = first(f"moments.{prefix}log_score_people")
        human[f"{kind}_r"] = first(f"human.{prefix}split_half_r")
        human[f"{prefix}log_score"] = first(f"human.{prefix}log_score_people")
    return {"human": human, "moments": moments, "doubt": doubt}


def _cell(metrics: Mapping[str, Any], place: str | Place) -> str:
    """Return a table's text for a place in the metrics."""
    found = at(metrics, place)
    if place == "cpu_seconds" and found is not None:
        return f"{found['value']:.3g}"
    if isinstance(found, float):
        return f"{found:.2f}"
    if isinstance(found, int):
        return str(found)
    if found is not None and "accuracy" in found:
        return f"{measure_text(found['accuracy'])} of {found['n']}"
    return measure_text(found)


# --- tables of differences ------------------------------------------------------------------------

PAIRS: Final = 15  # most pairs of models that are printed; beyond, only those with the first model

_DIFFERENCES: Final = {
    "right answers": "accuracy",
    "the log probability of the true answer, nats": "log_score_truth",
}


def difference_tables(
    differences: Sequence[Mapping[str, Any]], first: str | None = None
) -> list[Table]:
    """Return the tables of paired differences: in right answers, in log probabilities.

    With more than :data:`PAIRS` pairs only those with the model ``first`` are shown, if one is
    given.
    """
    found = {(r["one"], r["other"], r["measure"]): r for r in differences if not r["scenario"]}
    tables, note = [], "p: bootstrap, corrected by Holm over the pairs"
    for title, measure in _DIFFERENCES.items():
        measures = [f"{kind}_{measure}" for kind in KIND_WORDS]
        pairs = list(dict.fromkeys((one, other) for one, other, m in found if m in measures))
        if len(pairs) > PAIRS and first is not None:
            pairs = [pair for pair in pairs if first in pair]
            note = "p: bootstrap, corrected by Holm over all pairs; more pairs are in .differences"
        if pairs:
            columns = {}
            for name, word in zip(measures, KIND_WORDS.values(), strict=True):
                rows = [found.get((*pair, name)) for pair in pairs]
                columns[word, ""] = [measure_text(r, signed=True) for r in rows]
                columns[word, "p"] = [p_text(r["p_holm"] if r else None) for r in rows]
            index = pd.MultiIndex.from_tuples(pairs, names=("one", "other"))
            cells = pd.DataFrame(columns, index)
            cells.columns = [part or word for word, part in columns]
            tables.append(Table(f"paired differences in {title}", cells))
    return [*tables[:-1], *(table._replace(note=note) for table in tables[-1:])]


def equivalence_tables(equivalence: Sequence[Mapping[str, Any]], margin: float) -> list[Table]:
    """Return the table of equivalence with people, if there is one."""
    rows = [row for row in equivalence if row["scenario"] is None]
    if not rows:
        return []
    cells = pd.DataFrame(
        {
            "": [KIND_WORDS[row["measure"].removesuffix("_accuracy")] for row in rows],
            "value [90 %]": [
                measure_text({**row, "ci_low": row["low"], "ci_high": row["high"]}, signed=True)
                for row in rows
            ],
            "p equiv.": [p_text(row["p_equivalent_holm"]) for row in rows],
            "p differ": [p_text(row["p_holm"]) for row in rows],
            "verdict": [row["verdict"] for row in rows],
        },
        pd.Index([row["model"] for row in rows], name="model minus people"),
    )
    note = (
        f"Tested is a model's being right minus the share of people who are right, event by event. "
        f"Equivalent: both one-sided tests reject a difference of {margin:g} or more (p equiv.); "
        "higher, lower: there is one (p differ). Both corrected by Holm over the models; neither "
        f"shown: undecided. Fewer than {LEAST_EVENTS} events are not tested for equivalence. "
        "comparison.json has differences and equivalence by scenario, or by agent and pair, too."
    )
    return [Table(f"equivalence with people, margin {margin:g}", cells, note)]
