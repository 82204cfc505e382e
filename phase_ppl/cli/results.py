"""The commands on results: ``query``, ``diagnose`` and ``report``."""

from __future__ import annotations

import json
import shlex
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any, Final

import phase_ppl
from phase_ppl.cli import users_parts
from phase_ppl.cli.commands import FAILED, POSTERIOR, Options
from phase_ppl.world.errors import InvalidEventError, InvalidSettingError, QueryError
from phase_ppl.world.files import as_path, writable_folder
from phase_ppl.world.picture import plain

_MOST_LINES: Final = 40  # most entries of a printed table
_LEAST: Final = 0.0005  # less probable values are not printed one by one


def query(options: Options) -> int:
    """Ask a saved posterior, as in 'P(relation=friendly | goal_red=get to green agent)'.

    Every answer comes with its Monte-Carlo error, from the spread between the particles.

      P(relation=friendly)                       the probability of an event
      P(relation=friendly, strength_red > 400)   of several things at once
      P(goal_red), P(goal_red, relation)         of every value; of every combination
      odds(relation=friendly)                    against its opposite
      P(relation=friendly) / P(alpha=(1, 0))     one number over another: P, E, sd, median
      E[strength_red]   sd(...)   hdi 90% ...    mean; standard deviation; shortest interval
      median(strength_red)                       median
      mode(goal_red)    top 3 goal_red           the most probable value; the three
      H(goal_red)       I(goal_red; goal_green)  entropy, mutual information, nats

    "|" adds what is given: P(relation=friendly | goal_red=Get blue item to red lm).
    Conditions: =, !=, in {a, b}; for numbers <, <=, >, >=, in [a, b]; with another
    quantity in place of a value: P(strength_red > strength_green). They are joined by
    "or", "and", "not", round brackets, and "," for what holds as well: P(relation=friendly
    or target_red = target_green, not alpha=(0, 0)). Brackets after the first word may be
    left out. Values in any case and spacing, in quotes where they hold a special character.

    Args:
        $posterior
        QUESTION...:
        --prior NAME: under another prior: a name, or FILE.py:NAME, which is run
        --json: answers as JSON, a list

    quantities: goal_A, goal_kind_A, target_A, landmark_A, sign_A, stated_goal_A and
    strength_A, with A = red or green; relation, scenario, alpha; sites of your own.

    example: phase-ppl query out "P(relation=friendly)" "top 3 goal_red"
    """
    post = _posterior(options)
    if options.prior is not None:
        post = post.with_prior(users_parts.taken(options.prior, "prior"))
    answers, failed = list[tuple[str, Any]](), list[QueryError]()
    for question in options.question:
        try:
            answers.append((question, post.query(question)))
        except QueryError as error:
            failed.append(error)
    if failed and not answers:
        raise failed[0]
    if options.json:
        _print_json([{"question": q, **_record(found)} for q, found in answers], 2)
    else:
        for question, found in answers:
            print("\n".join(_lines(" ".join(question.split()), found)))
    for one in failed:
        print(f"phase-ppl: error: {one}", file=sys.stderr)
    return FAILED if failed else 0


def _posterior(options: Options) -> Any:
    """Return the posterior of a file, or of a folder of results with posterior.nc."""
    file: Path = options.file
    if as_path(file).is_dir():
        if not (file / POSTERIOR).is_file():
            kept = min(file.glob(f"events/*/{POSTERIOR}"), default=None)
            hint = ""
            if kept is not None:
                hint = f"; it holds an evaluation, with one such as {shlex.quote(str(kept))}"
            raise InvalidEventError(f"{file} holds no {POSTERIOR}{hint}")
        file = file / POSTERIOR
    return phase_ppl.load_posterior(file, options.weights)


def _print_json(record: Any, indent: int) -> None:
    print(json.dumps(plain(record), indent=indent, ensure_ascii=False, allow_nan=False))


def _record(found: Any) -> dict[str, Any]:
    """Return an answer as plain data.

    It has one of: ``value`` and ``error``; ``bounds``, a list of two such; or ``values``, a list of
    such with a probability above 0, the most probable first. Values have labels by quantity
    (for top, by ``value``).
    """
    if isinstance(found, phase_ppl.Estimate):
        return {"value": float(found), "error": found.error}
    if isinstance(found, str):
        return {"value": str(found), "error": found.error}  # type: ignore[attr-defined]
    if not isinstance(found, list) and "bound" in found.dims:
        return {"bounds": [_record(bound) for bound in _bounds(found)]}
    names = ("value",) if isinstance(found, list) else found.dims
    return {
        "values": [
            {**dict(zip(names, labels, strict=True)), "probability": float(p), "error": p.error}
            for labels, p in _ranked(found)
        ]
    }


def _lines(question: str, found: Any) -> Iterator[str]:
    """Return an answer as lines of text."""
    if isinstance(found, phase_ppl.Estimate):
        yield f"{question} = {found}"
    elif isinstance(found, str):
        error = found.error  # type: ignore[attr-defined]
        doubt = f"another leads with probability {error:.2g}" if error == error else "± unknown"
        yield f"{question} = {found} ({doubt})"
    elif not isinstance(found, list) and "bound" in found.dims:
        yield f"{question} = {' to '.join(map(str, _bounds(found)))}"
    else:
        entries = _ranked(found)
        shown = entries
        if not isinstance(found, list):
            shown = [entry for entry in entries if entry[1] >= _LEAST][:_MOST_LINES]
        yield f"{question}:"
        width = max(len(str(p)) for _, p in shown)
        for labels, p in shown:
            yield f"  {p!s:<{width}}  {', '.join(labels)}"
        if rest := entries[len(shown) :]:
            together = sum(float(p) for _, p in rest)
            yield f"  {together:.1g} in all on {len(rest)} more (--json has them)"


def _bounds(found: Any) -> list[phase_ppl.Estimate]:
    pairs = zip(found.values, found["error"].values, strict=True)
    return [phase_ppl.Estimate(value, error) for value, error in pairs]


def _ranked(found: Any) -> list[tuple[tuple[str, ...], phase_ppl.Estimate]]:
    """Return (labels, probability) of positive probabilities, descending, ties in order."""
    if isinstance(found, list):
        return [((label,), p) for label, p in found]
    # no data frame: a quantity may be called as its columns
    values, errors = found.to_series(), found["error"].to_series()
    shown = values[values > 0].sort_values(ascending=False, kind="stable")
    labels = shown.index.to_frame().astype(str).itertuples(index=False, name=None)
    numbers = map(phase_ppl.Estimate, shown, errors.loc[shown.index])
    return list(zip(labels, numbers, strict=True))


# --- diagnose --------------------------------------------------------------------------------


def diagnose(options: Options) -> None:
    """Say whether the chains of a posterior can be trusted.

    Args:
        $posterior
        --json: JSON instead of a table
        --out DIR: for the figures

    example: phase-ppl diagnose out --out out
    """
    post = _posterior(options)
    found = post.diagnostics()
    sampled = isinstance(post, phase_ppl.Posterior)
    figures = []
    if options.out is not None:
        if not sampled:
            raise InvalidSettingError(
                f"--out: {options.file} has a posterior of the closed loop, which has no chains to "
                "draw: leave --out out"
            )
        out = writable_folder(options.out)
        figures = [phase_ppl.plot.diagnostics]
        if "step_log_likelihood" in post.tree["simulations"].dataset:
            figures.append(phase_ppl.plot.over_time)
        for draw in figures:
            draw(post, out / f"{draw.__name__}.png")
    if options.json:
        _print_json(dict(found), 1)
        return
    print(found if sampled else post)
    if figures:
        names = ", ".join(f"{draw.__name__}.png" for draw in figures)
        print(f"\nWritten to {options.out}: {names}")
    elif sampled:
        print("\nNothing was drawn; --out DIR keeps figures.")


# --- report ----------------------------------------------------------------------------------


def report(options: Options) -> None:
    """Make one self-contained HTML page of an evaluation or a comparison.

    Args:
        FOLDER: written by evaluate --out or compare-models --out
        --out FILE: .html; default report.html in FOLDER
        $progress

    example: phase-ppl report out
    """
    if options.out is not None:
        options.suffix(".html")
    path = options.call(phase_ppl.report, path=options.out)
    print(f"{path.stat().st_size / 1e6:.1f} MB written to {path}")
