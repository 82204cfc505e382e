"""An evaluation as a table for a terminal, of at most 88 columns."""

from __future__ import annotations

import textwrap
from collections.abc import Iterator, Mapping, Sequence
from typing import TYPE_CHECKING, Any, Final, NamedTuple

from phase_ppl.analysis.summary import WIDTH
from phase_ppl.world.relations import SCENARIOS

if TYPE_CHECKING:
    from phase_ppl.evaluation.evaluation import Evaluation

PEOPLE: Final = "people"

_LABEL: Final = 24
_OWN: Final = 19
_NAME: Final = 16
_GAP: Final = "  "
_NOTHING: Final = "-"
_INTERVALS: Final = "95 %; of right answers Clopper-Pearson, of scores and r over resampled events"
Path = tuple[str, ...]


class _Row(NamedTuple):
    """A row: its label, where models have the figure, and where people have theirs.

    People's figures with a path that begins with "human" are among the model's metrics, as they
    are about the same events.
    """

    label: str
    path: Path
    people: Path = ()


class _Column(NamedTuple):
    """A column: whose figures it has, their metrics, and whether with intervals."""

    name: str
    metrics: Mapping[str, Any]
    width: int
    whole: bool = False


def table(evaluation: Evaluation) -> str:
    """Return the metrics of an evaluation by scenario, beside those of people and references."""
    metrics = evaluation.metrics
    head = f"{len(evaluation.predictions)} of {len(evaluation.events)} events"
    lines = _wrapped(evaluation.name, f"{head}, seed {evaluation.settings['seed']}")
    columns = [
        _Column(evaluation.name, metrics, _OWN, whole=True),
        _narrow(PEOPLE, metrics["people"]),
        *(_narrow(name, found) for name, found in metrics["reference_models"].items()),
    ]
    lines += _figures(_rows(metrics), columns, metrics)
    lines += ["", *_wrapped("intervals", _INTERVALS), *_wrapped("cost", _cost(evaluation.cost))]
    for event, failure in evaluation.failures.items():
        lines += _wrapped("failed", f"{event}: {failure}")
    for note in evaluation.notes:
        lines += _wrapped("note", note)
    return "\n".join(lines)


def difference_table(found: Mapping[str, Any]) -> str:
    """Return the differences that ``Evaluation.against`` found."""
    lines = _wrapped(
        f"{found['one']} minus {found['other']}",
        f"on the {found['n_events']} events that both "
        "predict; intervals and p from resampled events",
    )
    column = _Column("difference", found, _OWN + 9, whole=True)
    return "\n".join([*lines, *_figures(_rows(found), [column], {})])


def _rows(metrics: Mapping[str, Any]) -> Iterator[_Row]:
    """Yield the rows of a table."""
    for kind, title in (("goal", "goals right"), ("relation", "relation right")):
        name = f"{kind}_accuracy"
        yield _Row(title, (name,), (name,))
        for scenario in SCENARIOS:
            n = metrics["by_scenario"].get(scenario, {}).get("n")
            path = ("by_scenario", scenario, name)
            yield _Row(f"  {scenario} ({n})" if n else f"  {scenario}", path, path)
        if kind == "goal":
            yield _Row("  among the top 3", ("goal_top3_accuracy",))
        yield _Row("  log score of truth", (f"{kind}_log_score_truth",))
    for kind, prefix in (("goal", "goal_"), ("relation", "")):
        score, js = f"{prefix}log_score", f"{prefix}js"
        yield _Row(
            f"r with people, {kind}", ("human", f"{kind}_r"), ("human", f"{prefix}split_half_r")
        )
        if kind == "relation":
            yield _Row("  given the truth", ("human", "relation_r_given_truth"))
        yield _Row("  log score", ("human", score), ("human", f"{score}_people"))
        yield _Row("  JS divergence", ("human", js))


def _narrow(name: str, metrics: Mapping[str, Any]) -> _Column:
    return _Column(name, metrics, min(len(name), _NAME) + len(_GAP))


def _figures(
    rows: Iterator[_Row], columns: Sequence[_Column], metrics: Mapping[str, Any]
) -> list[str]:
    """Return the lines of a table; rows and columns without a figure are left out."""
    found = [(row, [_figure(row, column, metrics) for column in columns]) for row in rows]
    used = [i for i in range(len(columns)) if any(figures[i] for _, figures in found)]
    lines = []
    for block in _blocks(used, columns):
        names = "".join(f"{columns[i].name[:_NAME]:>{columns[i].width}}" for i in block)
        lines += ["", f"{'':<{_LABEL}}{names}"]
        for row, figures in found:
            if any(figures[i] for i in block):
                cells = "".join(_cell(figures[i], columns[i]) for i in block)
                lines.append(f"{row.label:<{_LABEL}}{cells}")
    return lines


def _figure(row: _Row, column: _Column, metrics: Mapping[str, Any]) -> dict[str, Any] | None:
    path, found = row.path, column.metrics
    if column.name == PEOPLE:
        path, found = row.people, metrics if row.people[:1] == ("human",) else found
    place: Any = found if path else None
    for name in path:
        place = (place or {}).get(name)
    return place


def _blocks(used: Sequence[int], columns: Sequence[_Column]) -> Iterator[list[int]]:
    """Yield as many columns as fit side by side, again and again."""
    block: list[int] = []
    width = _LABEL
    for i in used:
        if block and width + columns[i].width > WIDTH:
            yield block
            block, width = [], _LABEL
        block.append(i)
        width += columns[i].width
    if block:
        yield block


def _cell(figure: Mapping[str, Any] | None, column: _Column) -> str:
    if figure is None:
        return f"{_NOTHING:>{column.width}}"
    text = f"{figure['value']:.2f}"
    if column.whole and figure["ci_low"] is not None:
        text += f" [{figure['ci_low']:.2f}, {figure['ci_high']:.2f}]"
    if figure.get("p") is not None:
        text += f" p {figure['p']:.3f}"
    return f"{text:>{column.width}}"


def _cost(cost: Mapping[str, Any]) -> str:
    words = f"{_time(cost['seconds'])} in all"
    if cost["simulations"] is not None:
        words = f"{cost['simulations']} simulations, {words}"
    if cost["wall_seconds"] is not None:
        on = f" with {cost['workers']} worker{'' if cost['workers'] == 1 else 's'}"
        words += f"; this call took {_time(cost['wall_seconds'])}{on}"
    return words


def _time(seconds: float) -> str:
    return f"{seconds:.1f} s" if seconds < 100 else f"{seconds / 60:.1f} min"


def _wrapped(label: str, text: str) -> list[str]:
    first = f"{label}: "
    return textwrap.wrap(text, WIDTH, initial_indent=first, subsequent_indent=" " * 4)
