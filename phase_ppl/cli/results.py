"""The commands on what was inferred or evaluated: ``query``, ``diagnose`` and ``report``."""

from __future__ import annotations

import argparse
import json
import sys
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

import numpy as np

import phase_ppl
from phase_ppl.cli import commands as cli
from phase_ppl.cli import own
from phase_ppl.world.errors import InvalidSettingError, QueryError
from phase_ppl.world.files import writable_folder
from phase_ppl.world.picture import LABEL, plain, wrapped

if TYPE_CHECKING:
    import xarray as xr

    Ranked = list[tuple[tuple[str, ...], phase_ppl.Estimate]]


def _add_posterior(parser: argparse.ArgumentParser) -> None:
    cli.add(parser, "file FILE", "a posterior's .nc file, or the folder of infer", Path)
    cli.add(
        parser,
        "--weights NAME",
        "count, stratified or likelihood; default: the file's",
    )


# --- query -----------------------------------------------------------------------------------

_MOST_LINES: Final = 40  # entries of a table that are printed, at most
_LEAST: Final = 0.0005  # probability below which they are not printed one by one
_HELP: Final = """\
Ask a saved posterior. Every answer comes with its Monte-Carlo error, from the
spread between the particles.

  P(relation=friendly)                       the probability of an event
  P(relation=friendly, strength_red > 400)   of several things at once
  P(goal_red), P(goal_red, relation)         of every value; of every combination
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
--define FILE adds quantities, a line each: same_goal: goal_red = goal_green"""

_QUANTITIES: Final = """\
quantities: goal_A, goal_kind_A, target_A, landmark_A, sign_A, stated_goal_A and
strength_A, with A = red or green; relation, scenario, alpha; sites of your own.

example: phase-ppl query out "P(relation=friendly)" "top 3 goal_red" """


def add_to(commands: Any) -> None:
    """Add the commands."""
    _add_query(commands)
    _add_diagnose(commands)
    _add_report(commands)


def _add_query(commands: Any) -> None:
    parser = commands.add_parser(
        "query",
        description=_HELP,
        epilog=_QUANTITIES,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    parser.set_defaults(run=_query)
    _add_posterior(parser)
    cli.add(parser, "questions QUESTION", nargs="+")
    cli.add(parser, "--prior NAME", "under another prior: a name, or FILE.py:NAME, which is run")
    cli.add(parser, "--define FILE", "quantities of your own, a line each: NAME: CONDITIONS", Path)
    cli.add(parser, "--json", "answers as JSON, a list")


def _query(options: argparse.Namespace) -> int:
    post = cli.posterior(options.file, options.weights)
    if options.prior is not None:
        post = post.with_prior(own.taken(options.prior, "prior"))
    try:
        if options.define is not None:
            post.define_from(options.define)
        answers = [post.query(question) for question in options.questions]
    except QueryError as error:  # its lines show the place
        print(f"phase-ppl: error: {error}", file=sys.stderr)
        return cli.BAD_INPUT
    pairs = list(zip(options.questions, answers, strict=True))
    if options.json:
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
    if not isinstance(found, list) and "bound" in found.dims:
        pairs = zip(found.values, found["error"].values, strict=True)
        return {"bounds": [{"value": value, "error": error} for value, error in pairs]}
    names = ("value",) if isinstance(found, list) else tuple(map(str, found.dims))
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
        doubt = f"another leads with probability {error:.2g}" if error == error else "± ?"
        yield f"{question} = {found} ({doubt})"
    elif isinstance(found, list):
        yield from _table(question, _ranked(found))
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


def _table(question: str, entries: Ranked) -> Iterator[str]:
    yield f"{question}:"
    width = max(len(str(p)) for _, p in entries)
    for labels, p in entries:
        yield f"  {p!s:<{width}}  {', '.join(labels)}"


def _ranked(table: xr.DataArray | list[tuple[str, phase_ppl.Estimate]]) -> Ranked:
    """Return (labels, probability) of what has any, the most probable first, ties in order."""
    if isinstance(table, list):
        return [((label,), p) for label, p in table]
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


# --- diagnose --------------------------------------------------------------------------------

_NAME: Final = 38
_BLOCKS: Final = 10
"""Stretches of iterations whose acceptance is printed, at most."""


def _add_diagnose(commands: Any) -> None:
    parser = cli.command(commands, "diagnose", _diagnose, "phase-ppl diagnose out --out out")
    _add_posterior(parser)
    cli.add(parser, "--json", "JSON instead of a table")
    cli.add(parser, "--out DIR", "for the figures", Path)


def _diagnose(options: argparse.Namespace) -> int:
    post = cli.posterior(options.file, options.weights)
    found = post.diagnostics()
    record = json.dumps(plain(dict(found)), indent=1, ensure_ascii=False, allow_nan=False)
    if not isinstance(post, phase_ppl.Posterior):
        if options.out is not None:
            raise InvalidSettingError(
                f"--out: {options.file} was read step by step, it has no chains to draw"
            )
        print(record if options.json else post)
        return 0
    written = [] if options.out is None else _figures(post, writable_folder(options.out))
    if options.json:
        print(record)
        return 0
    print(table(post.event_id, found))
    if options.out is None:
        print("\nNothing was drawn; --out DIR keeps figures.")
    else:
        print(f"\nWritten to {options.out}: {', '.join(written)}")
    return 0


def _figures(post: Any, out: Path) -> list[str]:
    phase_ppl.plot.diagnostics(post, out / "diagnostics.png")
    if "step_log_likelihood" not in post.tree["simulations"].dataset:
        return ["diagnostics.png"]
    phase_ppl.plot.over_time(post, out / "over_time.png")
    return ["diagnostics.png", "over_time.png"]


def table(event_id: str, found: Mapping[str, Any]) -> str:
    """Return diagnostics as a table of at most 88 columns."""
    from phase_ppl.analysis.verdict import verdict_lines

    head = (
        f"{event_id}: {found['particles']} particles x {found['iterations']} iterations, "
        f"{found['kernel']} ({found['validity']}), weights {found['weights']}"
    )
    lines = [
        *wrapped("diagnostics", head),
        "",
        *wrapped("accepted", _accepted(found)),
        *wrapped("moved", _moved(found)),
        *wrapped("windows", _windows(found["windows"])),
        *wrapped("simulations", _simulations(found)),
        "",
        _row("", ("R-hat", "bulk ESS", "tail ESS"), 12),
        *_scalars(found["scalars"]),
        "",
        _row("", ("P", "draws", "MCSE", "ESS", "R-hat"), 7),
        *_categories(found),
        *verdict_lines(found),
    ]
    return "\n".join(lines)


def _scalars(scalars: Mapping[str, Any]) -> Iterator[str]:
    for name, entry in scalars.items():
        sizes = (_number(entry["ess_bulk"], 0), _number(entry["ess_tail"], 0))
        yield _row(name.replace("_", " "), (_number(entry["r_hat"]), *sizes), 12)


def _categories(found: Mapping[str, Any]) -> Iterator[str]:
    for name, categories in found["categories"].items():
        label = name.replace("_", " ")
        for category, entry in categories.items():
            numbers = map(_number, (entry["probability"], entry["share"], entry["mcse"]))
            cells = (*numbers, _number(entry["ess"], 0), _number(entry["r_hat"]))
            yield _row(f"{label:<{LABEL}}{category}", cells, 7)
            label = ""
        apart = found["between_chain_tv"].get(name)
        if apart is not None:
            yield from wrapped(
                "",
                f"the same goal leads in {found['agreement'][name]:.0%} of the particles; two "
                f"differ by {apart['mean']:.2f} on average, by {apart['max']:.2f} at most "
                "(total variation)",
            )
        yield ""


def _row(label: str, cells: tuple[str, ...], width: int) -> str:
    room = LABEL + _NAME
    return (f"{label[: room - 1]:<{room}}" + "".join(f"{cell:>{width}}" for cell in cells)).rstrip()


def _accepted(found: Mapping[str, Any]) -> str:
    rates = found["acceptance_by_iteration"]
    blocks = np.array_split(np.array(rates), min(len(rates), _BLOCKS))
    shares = " ".join(f"{100 * part.mean():.0f}" for part in blocks)
    of_what = (
        "by iteration" if len(rates) <= _BLOCKS else f"by tenth of the {len(rates)} iterations"
    )
    return f"{found['acceptance_rate']:.0%} of the proposals; {of_what}, in percent: {shares}"


def _moved(found: Mapping[str, Any]) -> str:
    distinct = (
        f"{found['distinct_hypotheses']} distinct hypotheses, "
        f"{found['distinct_goal_pairs']} pairs of goals"
    )
    if found["move_rate"] is None:
        return distinct
    return f"to another pair of goals in {found['move_rate']:.0%} of the iterations; {distinct}"


def _windows(windows: Mapping[str, Any]) -> str:
    if not windows["proposals"]:
        return "no proposal came from a window"
    starts = np.repeat(windows["starts"], windows["counts"])
    low, high = np.quantile(starts, (0.25, 0.75)).round().astype(int)
    text = f"{windows['proposals']} proposals from {len(windows['starts'])} windows"
    if windows["frames"] is not None:
        text += f" of {windows['frames']} frames"
    text += f", half of which begin in frames {low} to {high}"
    return f"{text}; {windows['without']} from none" if windows["without"] else text


def _simulations(found: Mapping[str, Any]) -> str:
    counts = found["simulations"]
    return (
        f"{counts['total']}: {counts['completed']} completed, {counts['aborted']} stopped early "
        f"(saved {found['frames_saved_share']:.0%} of the frames), {counts['failed']} failed; the "
        f"best draw is {found['best_error_per_frame']:.2f} units per frame from the observation"
    )


def _number(value: float | None, digits: int = 2) -> str:
    return "-" if value is None else f"{value:.{digits}f}"


# --- report ----------------------------------------------------------------------------------


def _add_report(commands: Any) -> None:
    parser = cli.command(commands, "report", _report, "phase-ppl report out")
    cli.add(
        parser, "folder DIR", "written by infer --out, evaluate --out or compare-models --out", Path
    )
    cli.add(parser, "--out FILE", ".html; default report.html in DIR", Path)
    cli.add(parser, "--videos", "film every event of an evaluation as well")
    cli.share(parser, "progress")


def _report(options: argparse.Namespace) -> int:
    if options.out is not None:
        cli.check_suffix(options.out, (".html",))
        writable_folder(options.out.parent)
    path = phase_ppl.report(path=options.out, **cli.arguments(phase_ppl.report, options))
    print(f"{path.stat().st_size / 1e6:.1f} MB written to {path}")
    return 0
