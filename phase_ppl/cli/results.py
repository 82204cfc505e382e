"""The commands on what was inferred or evaluated: ``query``, ``diagnose`` and ``report``."""

from __future__ import annotations

import json
import shlex
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any, Final

import numpy as np

import phase_ppl
from phase_ppl.cli import own
from phase_ppl.cli.commands import POSTERIOR, Options
from phase_ppl.world.errors import InvalidEventError, InvalidSettingError
from phase_ppl.world.files import as_path, writable_folder
from phase_ppl.world.picture import LABEL, plain, wrapped

_MOST_LINES: Final = 40  # entries of a table that are printed, at most
_LEAST: Final = 0.0005  # probability below which they are not printed one by one


def query(options: Options) -> None:
    """Ask a saved posterior, as in 'P(relation=friendly | goal_red=get to green agent)'.

    Every answer comes with its Monte-Carlo error, from the spread between the particles.

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
    --define FILE adds quantities, a line each: same_goal: goal_red = goal_green

    Args:
        $posterior
        QUESTION...:
        --prior NAME: under another prior: a name, or FILE.py:NAME, which is run
        --define FILE: quantities of your own, a line each: NAME: CONDITIONS
        --json: answers as JSON, a list

    quantities: goal_A, goal_kind_A, target_A, landmark_A, sign_A, stated_goal_A and
    strength_A, with A = red or green; relation, scenario, alpha; sites of your own.

    example: phase-ppl query out "P(relation=friendly)" "top 3 goal_red"
    """
    post = _posterior(options)
    if options.prior is not None:
        post = post.with_prior(own.taken(options.prior, "prior"))
    if options.define is not None:
        post.define_from(options.define)
    answers = [(question, post.query(question)) for question in options.question]
    if options.json:
        _print_json([{"question": question, **_record(found)} for question, found in answers], 2)
        return
    for question, found in answers:
        print("\n".join(_lines(" ".join(question.split()), found)))


def _posterior(options: Options) -> Any:
    """Return the posterior of a file, or of the folder of results that holds posterior.nc."""
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

    One of ``value`` and ``error``; ``bounds``, a list of two such; or ``values``, a list of those
    with a probability above 0, the most probable first, each with its labels by quantity (by
    ``value`` for top).
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
        doubt = f"another leads with probability {error:.2g}" if error == error else "± ?"
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
    """Return (labels, probability) of what has any, the most probable first, ties in order."""
    if isinstance(found, list):
        return [((label,), p) for label, p in found]
    table = found.to_dataframe("p").query("p > 0").sort_values("p", ascending=False, kind="stable")
    labels = table.index.to_frame().astype(str).itertuples(index=False, name=None)
    numbers = map(phase_ppl.Estimate, table["p"], table["error"])
    return list(zip(labels, numbers, strict=True))


# --- diagnose --------------------------------------------------------------------------------

_NAME: Final = 38
_BLOCKS: Final = 10
"""Stretches of iterations whose acceptance is printed, at most."""


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
                f"--out: {options.file} was read step by step, it has no chains to draw"
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
    print(_table(post.event_id, found) if sampled else post)
    if figures:
        names = ", ".join(f"{draw.__name__}.png" for draw in figures)
        print(f"\nWritten to {options.out}: {names}")
    elif sampled:
        print("\nNothing was drawn; --out DIR keeps figures.")


def _table(event_id: str, found: Mapping[str, Any]) -> str:
    """Return diagnostics as a table of at most 88 columns."""
    from phase_ppl.analysis.verdict import verdict_lines

    rates, counts = found["acceptance_by_iteration"], found["simulations"]
    blocks = np.array_split(np.array(rates), min(len(rates), _BLOCKS))
    few = len(rates) <= _BLOCKS
    by = "by iteration" if few else f"by tenth of the {len(rates)} iterations"
    texts = {
        "diagnostics": f"{event_id}: {found['particles']} particles x {found['iterations']} "
        f"iterations, {found['kernel']} ({found['validity']}), weights {found['weights']}",
        "": "",
        "accepted": f"{found['acceptance_rate']:.0%} of the proposals; {by}, in percent: "
        + " ".join(f"{100 * part.mean():.0f}" for part in blocks),
        "moved": (
            ""
            if found["move_rate"] is None
            else f"to another pair of goals in {found['move_rate']:.0%} of the iterations; "
        )
        + f"{found['distinct_hypotheses']} distinct hypotheses, "
        f"{found['distinct_goal_pairs']} pairs of goals",
        "windows": _windows(found["windows"]),
        "simulations": f"{counts['total']}: {counts['completed']} completed, {counts['aborted']} "
        f"stopped early (saved {found['frames_saved_share']:.0%} of the frames), "
        f"{counts['failed']} failed; the best draw is {found['best_error_per_frame']:.2f} units "
        "per frame from the observation",
    }
    lines = [line for label, text in texts.items() for line in wrapped(label, text) or [""]]
    lines += ["", _row("", ("R-hat", "bulk ESS", "tail ESS"), 12)]
    for name, entry in found["scalars"].items():
        numbers = _number(entry["r_hat"]), *(_number(entry[f"ess_{of}"], 0) for of in _ESS)
        lines.append(_row(name.replace("_", " "), numbers, 12))
    lines += ["", _row("", ("P", "draws", "MCSE", "ESS", "R-hat"), 7)]
    for name, categories in found["categories"].items():
        label = name.replace("_", " ")
        for category, entry in categories.items():
            cells = [_number(entry[column]) for column in ("probability", "share", "mcse")]
            cells += [_number(entry["ess"], 0), _number(entry["r_hat"])]
            lines.append(_row(f"{label:<{LABEL}}{category}", cells, 7))
            label = ""
        if (apart := found["between_chain_tv"].get(name)) is not None:
            lines += wrapped(
                "",
                f"the same goal leads in {found['agreement'][name]:.0%} of the particles; two "
                f"differ by {apart['mean']:.2f} on average, by {apart['max']:.2f} at most "
                "(total variation)",
            )
        lines.append("")
    return "\n".join([*lines, *verdict_lines(found)])


_ESS: Final = ("bulk", "tail")


def _row(label: str, cells: Any, width: int) -> str:
    room = LABEL + _NAME
    return (f"{label[: room - 1]:<{room}}" + "".join(f"{cell:>{width}}" for cell in cells)).rstrip()


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


def _number(value: float | None, digits: int = 2) -> str:
    return "-" if value is None else f"{value:.{digits}f}"


# --- report ----------------------------------------------------------------------------------


def report(options: Options) -> None:
    """Make one self-contained HTML page of a run, an evaluation or a comparison.

    Args:
        FOLDER: written by infer --out, evaluate --out or compare-models --out
        --out FILE: .html; default report.html in FOLDER
        --videos: film every event of an evaluation as well
        $progress

    example: phase-ppl report out
    """
    if options.out is not None:
        options.suffix(".html")
    path = options.call(phase_ppl.report, path=options.out)
    print(f"{path.stat().st_size / 1e6:.1f} MB written to {path}")
