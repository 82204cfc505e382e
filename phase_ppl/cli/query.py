"""The command ``query``."""

from __future__ import annotations

import argparse
import json
import sys
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

import phase_ppl
from phase_ppl.cli.shared import BAD_INPUT, posterior
from phase_ppl.world.errors import QueryError

if TYPE_CHECKING:
    import xarray as xr

_MOST_LINES: Final = 40
"""Entries of a table that are printed, at most."""

_LEAST: Final = 0.0005
"""Probability below which they are not printed one by one."""

_HELP: Final = """\
Ask a saved posterior. Every answer comes with its Monte-Carlo error, from the
spread between the particles.

  P(relation=friendly)                       the probability of an event
  P(relation=friendly, strength_red > 400)   of several things at once
  P(goal_red), P(goal_red, relation)         of every value; of every combination
  E[strength_red]   sd(...)   hdi 90% ...    mean; standard deviation; shortest interval
  mode(goal_red)    top 3 goal_red           the most probable value; the three
  H(goal_red)                                entropy, nats

"|" adds what is given: P(relation=friendly | goal_red=Get blue item to red lm).
Conditions: =, !=, in {a, b}; for numbers <, <=, >, >=, in [a, b]. Brackets after
the first word may be left out. Values in any case and spacing, in quotes where
they hold a special character."""

_QUANTITIES: Final = """\
quantities: goal_A, goal_kind_A, target_A, landmark_A, sign_A, stated_goal_A and
strength_A, with A = red or green; relation, scenario, alpha; sites of your own.

example: phase-ppl query out "P(relation=friendly)" "top 3 goal_red" """


def add_to(commands: Any) -> None:
    """Add the command."""
    parser = commands.add_parser(
        "query",
        help="ask a saved posterior, as in 'P(relation=friendly | goal_red=get to green agent)'",
        description=_HELP,
        epilog=_QUANTITIES,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    parser.set_defaults(run=_query)
    parser.add_argument(
        "file", metavar="FILE", type=Path, help="a posterior's .nc file, or the folder of infer"
    )
    parser.add_argument("questions", metavar="QUESTION", nargs="+")
    parser.add_argument(
        "--weights",
        metavar="NAME",
        help="count, importance, visited or likelihood; default: the file's",
    )
    parser.add_argument("--json", action="store_true", help="answers as JSON, a list")


def _query(options: argparse.Namespace) -> int:
    post = posterior(options.file, options.weights)
    try:
        answers = [post.query(question) for question in options.questions]
    except QueryError as error:  # its lines show the place
        print(f"phase-ppl: error: {error}", file=sys.stderr)
        return BAD_INPUT
    pairs = list(zip(options.questions, answers, strict=True))
    if options.json:
        from phase_ppl.analysis.summary import plain

        records = [{"question": question, **_record(found)} for question, found in pairs]
        print(json.dumps(plain(records), indent=2, ensure_ascii=False, allow_nan=False))
    else:
        for question, found in pairs:
            print("\n".join(_lines(" ".join(question.split()), found)))
    return 0


def _record(found: Any) -> dict[str, Any]:
    """Return an answer as plain data.

    One of ``value`` and ``error``; ``bounds``, a list of two such; or ``values``, a list of those
    with a probability above 0, the most probable first, each with its labels by quantity (by
    ``value`` for top).
    """
    if isinstance(found, phase_ppl.Estimate):
        return {"value": float(found), "error": found.error}
    if isinstance(found, str):
        return {"value": str(found), "error": found.error}  # type: ignore[attr-defined]
    if isinstance(found, list):
        return {
            "values": [
                {"value": label, "probability": float(p), "error": p.error} for label, p in found
            ]
        }
    if "bound" in found.dims:
        pairs = zip(found.values, found["error"].values, strict=True)
        return {"bounds": [{"value": value, "error": error} for value, error in pairs]}
    return {
        "values": [
            {
                **dict(zip(map(str, found.dims), labels, strict=True)),
                "probability": float(p),
                "error": p.error,
            }
            for labels, p in _ranked(found)
        ]
    }


def _lines(question: str, found: Any) -> Iterator[str]:
    """Return an answer as lines of text."""
    if isinstance(found, phase_ppl.Estimate):
        yield f"{question} = {found}"
    elif isinstance(found, str):
        error = found.error  # type: ignore[attr-defined]
        doubt = f"another leads with probability {error:.2g}" if error == error else "± ?"
        yield f"{question} = {found} ({doubt})"
    elif isinstance(found, list):
        yield from _table(question, [((label,), p) for label, p in found])
    elif "bound" in found.dims:
        low, high = (
            phase_ppl.Estimate(value, error)
            for value, error in zip(found.values, found["error"].values, strict=True)
        )
        yield f"{question} = {low} to {high}"
    else:
        entries = _ranked(found)
        shown = [entry for entry in entries if entry[1] >= _LEAST][:_MOST_LINES]
        rest = entries[len(shown) :]
        yield from _table(question, shown)
        if rest:
            together = sum(float(p) for _, p in rest)
            yield f"  {together:.1g} in all on {len(rest)} more (--json has them)"


def _table(
    question: str, entries: Sequence[tuple[tuple[str, ...], phase_ppl.Estimate]]
) -> Iterator[str]:
    yield f"{question}:"
    width = max(len(str(p)) for _, p in entries)
    for labels, p in entries:
        yield f"  {p!s:<{width}}  {', '.join(labels)}"


def _ranked(table: xr.DataArray) -> list[tuple[tuple[str, ...], phase_ppl.Estimate]]:
    """Return (labels, probability) of what has any, the most probable first, ties in order."""
    import numpy as np

    values, errors = table.values, table["error"].values
    labels = [table[dim].values for dim in table.dims]
    cells = np.argwhere(values > 0)
    order = np.argsort(-values[tuple(cells.T)], kind="stable")
    return [
        (
            tuple(str(names[i]) for names, i in zip(labels, cell, strict=True)),
            phase_ppl.Estimate(values[tuple(cell)], errors[tuple(cell)]),
        )
        for cell in cells[order]
    ]
