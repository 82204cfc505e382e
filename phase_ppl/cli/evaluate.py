"""The command ``evaluate``."""

from __future__ import annotations

import argparse
import inspect
import sys
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

import phase_ppl
from phase_ppl.cli.shared import (
    FAILED,
    INTERRUPTED,
    budget,
    named_value,
    one_line,
    report_hint,
    whole,
    writable_folder,
)
from phase_ppl.world.errors import InvalidSettingError
from phase_ppl.world.files import write_json

if TYPE_CHECKING:
    from phase_ppl.evaluation.evaluation import Evaluation
    from phase_ppl.evaluation.folder import ResultsFolder

AGAINST: Final = "against.json"
"""The file in the folder of results that holds the differences from another model."""

_SHORT_FOR: Final = ("planner", "kernel", "budget", "weights", "prior")
"""Options of models that have options of the command of their own."""

_OF_WORK: Final = (
    *("model", "resume", "split", "limit", "seed", "judgments", "option"),
    *_SHORT_FOR,
)
"""Options that say nothing where an evaluation is only shown again."""


def add_to(commands: Any) -> None:
    """Add the command."""
    parser = commands.add_parser(
        "evaluate",
        help="ask a model about many events, and score what it answers",
        description="Ask a model about many events, longest first, and score what it answers. "
        "Without EVENTS, the evaluation in --out is read and shown again, to be compared by "
        "--against.",
        epilog="example: phase-ppl evaluate videos.json --model simple --planner fast --out out",
    )
    parser.set_defaults(run=_evaluate)
    parser.add_argument(
        "events",
        metavar="EVENTS",
        nargs="?",
        help="an event file, a folder of event files, or a bundled event's name",
    )
    parser.add_argument(
        "--model",
        metavar="NAME",
        help="simple (the default), last_frame or another",
    )
    parser.add_argument(
        "--out", metavar="DIR", type=Path, help="for predictions, metrics, figures and pages"
    )
    parser.add_argument(
        "--resume",
        action="store_true",
        default=None,
        help="go on with what is in --out; events may have been added at the end",
    )
    parser.add_argument("--split", metavar="NAME", help="of a generated set, such as test")
    parser.add_argument("--limit", metavar="N", type=whole(1), help="the first N events only")
    parser.add_argument(
        "--workers", metavar="N", type=whole(1), help="processes; default one per usable core"
    )
    parser.add_argument("--seed", metavar="N", type=whole(0), help="default 0")
    parser.add_argument(
        "--judgments", metavar="FILE", type=Path, help="people's judgments, a .csv file"
    )
    parser.add_argument(
        "--against",
        metavar="DIR",
        help="results of another model, or a model whose predictions the events carry, for "
        f"paired differences; written to {AGAINST}",
    )
    model = parser.add_argument_group("options of the model")
    model.add_argument("--planner", choices=("fast", "paper"))
    model.add_argument("--kernel", metavar="NAME")
    model.add_argument(
        "--budget", metavar="B", type=budget, help="simulations, as in 500, or seconds, as in 60s"
    )
    model.add_argument("--weights", metavar="NAME")
    model.add_argument("--prior", metavar="NAME")
    model.add_argument(
        "--option",
        metavar="NAME=VALUE",
        type=named_value,
        action="append",
        default=[],
        help="any other, such as chains=15 or rule=paper; may be given several times",
    )
    parser.add_argument("--no-figures", action="store_true", help="draw no figures and pages")
    parser.add_argument("--quiet", action="store_true", help="no progress bar")


def _evaluate(options: argparse.Namespace) -> int:
    found = _again(options) if options.events is None else _anew(options)
    if found is None:
        return INTERRUPTED
    print(found)
    code = FAILED if found.failures else 0
    if found.folder is not None and options.events is not None and not options.no_figures:
        for problem in _draw(found.folder, options.quiet):
            print(f"phase-ppl: error: {problem}", file=sys.stderr)
            code = FAILED
    if found.folder is None:
        print("\nNothing was saved; --out DIR keeps predictions, metrics and figures.")
    else:
        print(f"\nKept in {found.folder.path}\n{report_hint(found.folder.path)}")
    if options.against is not None:
        _write_difference(found, options)
    return code


def _anew(options: argparse.Namespace) -> Evaluation | None:
    """Evaluate; None where it was interrupted."""
    from phase_ppl.evaluation.evaluation import opponent
    from phase_ppl.evaluation.sources import all_events

    if options.resume and options.out is None:
        raise InvalidSettingError("--resume needs --out, the folder to go on in")
    events = all_events(options.events, options.split)
    if options.against is not None:
        opponent(events[: options.limit], options.against)  # what is wrong with it is said now
    if options.out is not None:
        writable_folder(options.out)
    try:
        return phase_ppl.evaluate(
            events,
            options.model or "simple",
            out=options.out,
            workers=options.workers,
            resume=bool(options.resume),
            limit=options.limit,
            seed=options.seed or 0,
            judgments=options.judgments,
            progress=not options.quiet,
            **_model_options(options),
        )
    except phase_ppl.EvaluationInterrupted as stopped:
        print(f"phase-ppl: {stopped}", file=sys.stderr)
        if options.out is not None:
            print("Go on with the same command and --resume", file=sys.stderr)
        return None


def _again(options: argparse.Namespace) -> Evaluation:
    """Read an evaluation that is there."""
    given = vars(options)
    nothing: tuple[Any, ...] = (None, [])
    of_work = [f"--{name}" for name in _OF_WORK if given[name] not in nothing]
    if options.out is None or of_work:
        needed = f" with {', '.join(of_work)}" if of_work else ""
        raise InvalidSettingError(
            f"EVENTS is missing{needed}; only to show the evaluation in --out again needs none"
        )
    return phase_ppl.Evaluation.load(options.out)


def _model_options(options: argparse.Namespace) -> dict[str, Any]:
    found = {
        name: getattr(options, name) for name in _SHORT_FOR if getattr(options, name) is not None
    }
    taken = inspect.signature(phase_ppl.evaluate).parameters
    for name, value in options.option:
        if name in found or name in taken:
            why = "given twice" if name in found else "no option of a model"
            raise InvalidSettingError(f"--option {name}: {why}")
        found[name] = value
    return found


def _write_difference(found: Evaluation, options: argparse.Namespace) -> None:
    from phase_ppl.evaluation.printed import difference_table

    difference = found.against(options.against)
    print(f"\n{difference_table(difference)}")
    if found.folder is not None:
        write_json(found.folder.path / AGAINST, difference)


def _draw(folder: ResultsFolder, quiet: bool) -> list[str]:
    """Draw figures and pages; return in words what could not be drawn."""
    from phase_ppl.evaluation.figures import draw_figures
    from phase_ppl.evaluation.folder import PAGE
    from phase_ppl.evaluation.pages import draw_page
    from phase_ppl.inference.runs.progress import counted

    problems = []
    try:
        draw_figures(folder, progress=not quiet)
    except Exception as error:  # the results are there, whatever becomes of their pictures
        problems.append(f"the figures cannot be drawn: {one_line(error)}")
    finished = [event.id for event in folder.events if folder.is_finished(event.id)]
    for event_id in counted(finished, not quiet, "page", "drawing"):
        try:
            draw_page(folder, event_id, folder.folder_of(event_id) / PAGE)
        except Exception as error:
            problems.append(f"the page of {event_id} cannot be drawn: {one_line(error)}")
    return problems
