"""The command ``evaluate``."""

from __future__ import annotations

import argparse
import inspect
import re
import sys
from collections.abc import Callable, Mapping, Sequence
from typing import TYPE_CHECKING, Any, Final

import phase_ppl
from phase_ppl.cli.compare_models import keep, stored_models
from phase_ppl.cli.shared import FAILED, INTERRUPTED, shows_progress, writable_folder
from phase_ppl.world.errors import InvalidSettingError, OutputError, unknown_name
from phase_ppl.world.event import Event

if TYPE_CHECKING:
    from phase_ppl.evaluation.folder import ResultsFolder
from pathlib import Path
from typing import TYPE_CHECKING

from phase_ppl.cli.compare_models import add_stored
from phase_ppl.cli.shared import (
    BUDGET,
    add_progress,
    budget,
    named_value,
    one_line,
    report_hint,
    whole,
)
from phase_ppl.world.files import write_json

if TYPE_CHECKING:
    from phase_ppl.evaluation.evaluation import Evaluation
    from phase_ppl.evaluation.folder import ResultsFolder


Draw = Callable[["ResultsFolder", argparse.Namespace], Sequence[str]]

_LABEL: Final = re.compile(r"[A-Za-z0-9][A-Za-z0-9_-]*")


def models_of(given: Sequence[str] | None) -> dict[str, str]:
    """Return label -> model of ``--model NAME`` or ``--model LABEL=NAME``, ``simple`` by default.

    Raises:
        InvalidSettingError: two have the same label, or one cannot be the name of a folder.
    """
    found: dict[str, str] = {}
    for text in given or ["simple"]:
        label, equals, name = text.partition("=")
        if label in found:
            raise InvalidSettingError(
                f"--model {label} is given twice: name them, as in --model one={name or label}"
            )
        if equals and not _LABEL.fullmatch(label):
            raise InvalidSettingError(f"--model {text}: {label!r} is no name for a folder")
        found[label] = name if equals else text
    return found


def options_of(
    models: Mapping[str, str], plain: Mapping[str, Any], named: Sequence[tuple[str, Any]]
) -> dict[str, dict[str, Any]]:
    """Return label -> options of the model.

    Args:
        models: label -> model.
        plain: options of every model that takes them; of a single model all.
        named: those of ``--option``, where "LABEL.NAME" is of one model, "NAME" plain.

    Raises:
        InvalidSettingError: one is given twice, or no model takes it.
        UnknownNameError: there is no such model, or label.
    """
    from phase_ppl.evaluation.registry import model_info

    taken = inspect.signature(phase_ppl.evaluate).parameters
    shared = dict(plain)
    own: dict[str, dict[str, Any]] = {label: {} for label in models}
    for text, value in named:
        label, dot, name = text.rpartition(".")
        if dot and label not in models:
            raise unknown_name(f"model in --option {text}:", label, models)
        place = own[label] if dot else shared
        if name in place or name in taken:
            why = "given twice" if name in place else "no option of a model"
            raise InvalidSettingError(f"--option {text}: {why}")
        place[name] = value
    if len(models) == 1:
        return {label: {**shared, **given} for label, given in own.items()}
    found: dict[str, dict[str, Any]] = {label: {} for label in models}
    for name, value in shared.items():
        takers = [
            label
            for label, model in models.items()
            if model_info(model).takes(name, {**shared, **own[label]})
        ]
        if not takers:
            raise InvalidSettingError(f"{name}: none of the models {', '.join(models)} takes it")
        for label in takers:
            found[label][name] = value
    return {label: {**found[label], **given} for label, given in own.items()}


def evaluate_several(
    options: argparse.Namespace,
    events: Sequence[Event],
    models: Mapping[str, str],
    of_models: Mapping[str, Mapping[str, Any]],
    draw: Draw,
) -> int:
    """Evaluate several models, each in a folder of its own, and compare them.

    Args:
        options: of the command.
        events: of the evaluation.
        models: label -> model.
        of_models: label -> its options.
        draw: draws figures and pages of an evaluation, and returns what went wrong.

    Returns:
        The exit code.

    Raises:
        PhasePPLError: something cannot be used, found out before the work.
    """
    _check(options, events, models, of_models)
    code = 0
    found = {}
    for label, model in models.items():
        out = None if options.out is None else options.out / label
        try:
            evaluation = phase_ppl.evaluate(
                events,
                model,
                out=out,
                workers=options.workers,
                resume=bool(options.resume),
                limit=options.limit,
                seed=options.seed or 0,
                judgments=options.judgments,
                progress=shows_progress(options),
                **of_models[label],
            )
        except phase_ppl.EvaluationInterrupted as stopped:
            print(f"phase-ppl: {label}: {stopped}", file=sys.stderr)
            if out is not None:
                print("Go on with the same command and --resume", file=sys.stderr)
            return INTERRUPTED
        except phase_ppl.PhasePPLError as error:
            raise type(error)(f"{label}: {error}") from None
        problems = list(evaluation.failures.items())
        for event, failure in problems:
            print(f"{label}: failed: {event}: {failure}", file=sys.stderr)
        if evaluation.folder is not None and not options.no_figures:
            drawn = draw(evaluation.folder, options)
            for problem in drawn:
                print(f"phase-ppl: error: {label}: {problem}", file=sys.stderr)
            code = FAILED if drawn else code
        code = FAILED if problems else code
        found[label] = evaluation
    comparison = phase_ppl.compare_models(
        found, stored=stored_models(options.stored), against=options.against
    )
    print(comparison)
    if options.out is None:
        print("\nNothing was saved; --out DIR keeps predictions, metrics and figures.")
        return code
    return keep(comparison, options.out, options) or code


def _check(
    options: argparse.Namespace,
    events: Sequence[Event],
    models: Mapping[str, str],
    of_models: Mapping[str, Mapping[str, Any]],
) -> None:
    """Find out what is wrong before the first model is asked."""
    from phase_ppl.evaluation.entries import check_names, stored_label, stored_names
    from phase_ppl.evaluation.evaluate import check_resumable, settings_of
    from phase_ppl.evaluation.folder import SETTINGS, holds_predictions
    from phase_ppl.evaluation.references import reference_predictions
    from phase_ppl.evaluation.registry import ready

    check_names(list(models))
    chosen = events[: options.limit]
    for label, model in models.items():
        asked = ready(model, of_models[label])
        if options.resume:
            settings = settings_of(asked, options.seed or 0, chosen)
            check_resumable(options.out / label, settings)
    references = reference_predictions(chosen)
    stored = stored_names(stored_models(options.stored), references)
    known = [*models, *(stored_label(name, models) for name in stored)]
    if options.against is not None and options.against not in known:
        raise unknown_name("model to compare with", options.against, known)
    if options.out is None:
        return
    if (options.out / SETTINGS).is_file():
        raise OutputError(f"--out {options.out} holds an evaluation of one model: name another")
    writable_folder(options.out)
    for label in models:
        if holds_predictions(options.out / label) and not options.resume:
            raise OutputError(
                f"{options.out / label} already holds an evaluation; --resume goes on"
            )


# --- the command ``evaluate`` ---------------------------------------------------------------------

AGAINST: Final = "against.json"
"""The file in the folder of results that holds the differences from another model."""

_RESUME_NEEDS: Final = "--resume needs --out, the folder to go on in"

_SHORT_FOR: Final = ("planner", "kernel", "budget", "weights", "prior")
"""Options of models that have options of the command of their own."""

_OF_WORK: Final = (
    *("model", "resume", "split", "limit", "seed", "judgments", "option", "stored"),
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
        action="append",
        help="simple (the default), last_frame or another; given several times, all are evaluated, "
        "each in a folder of its name in --out, and compared; LABEL=NAME gives another name",
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
        f"paired differences; written to {AGAINST}. With several models: the one of them from "
        "which the others' differences are wanted; default: every pair",
    )
    add_stored(parser)
    model = parser.add_argument_group(
        "options of the model; of several models, of all that take them"
    )
    model.add_argument("--planner", choices=("fast", "paper"))
    model.add_argument("--kernel", metavar="NAME")
    model.add_argument("--budget", metavar="B", type=budget, help=BUDGET)
    model.add_argument("--weights", metavar="NAME")
    model.add_argument("--prior", metavar="NAME")
    model.add_argument(
        "--option",
        metavar="NAME=VALUE",
        type=_option,
        action="append",
        default=[],
        help="any other, such as chains=15 or rule=paper, or of one of several models, such as "
        "simple.chains=15; may be given several times",
    )
    parser.add_argument("--no-figures", action="store_true", help="draw no figures and pages")
    add_progress(parser)


def _option(text: str) -> tuple[str, Any]:
    """Return name and value of NAME=VALUE or MODEL.NAME=VALUE."""
    label, dot, _ = text.partition("=")[0].rpartition(".")
    name, value = named_value(text.removeprefix(f"{label}{dot}"))
    return f"{label}{dot}{name}", value


def _evaluate(options: argparse.Namespace) -> int:
    models = models_of(options.model)
    several = len(models) > 1 or list(models) != list(models.values())
    if several and options.events is not None:
        return _several(options, models)
    found = _again(options) if options.events is None else _anew(options, *models)
    if found is None:
        return INTERRUPTED
    print(found)
    code = FAILED if found.failures else 0
    if found.folder is not None and options.events is not None and not options.no_figures:
        for problem in _draw(found.folder, options):
            print(f"phase-ppl: error: {problem}", file=sys.stderr)
            code = FAILED
    if found.folder is None:
        print("\nNothing was saved; --out DIR keeps predictions, metrics and figures.")
    else:
        print(f"\nKept in {found.folder.path}\n{report_hint(found.folder.path)}")
    if options.against is not None:
        _write_difference(found, options)
    return code


def _several(options: argparse.Namespace, models: Mapping[str, str]) -> int:
    from phase_ppl.evaluation.judgments import all_events

    if options.resume and options.out is None:
        raise InvalidSettingError(_RESUME_NEEDS)
    of_models = options_of(models, _short_for(options), options.option)
    events = all_events(options.events, options.split)
    return evaluate_several(options, events, models, of_models, _draw)


def _anew(options: argparse.Namespace, model: str) -> Evaluation | None:
    """Evaluate; None where it was interrupted."""
    from phase_ppl.evaluation.evaluation import opponent
    from phase_ppl.evaluation.judgments import all_events

    if options.resume and options.out is None:
        raise InvalidSettingError(_RESUME_NEEDS)
    if options.stored:
        raise InvalidSettingError("--stored is for several models; --against compares with one")
    events = all_events(options.events, options.split)
    if options.against is not None:
        opponent(events[: options.limit], options.against)  # what is wrong with it is said now
    if options.out is not None:
        writable_folder(options.out)
    try:
        return phase_ppl.evaluate(
            events,
            model,
            out=options.out,
            workers=options.workers,
            resume=bool(options.resume),
            limit=options.limit,
            seed=options.seed or 0,
            judgments=options.judgments,
            progress=shows_progress(options),
            **options_of({model: model}, _short_for(options), options.option)[model],
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


def _short_for(options: argparse.Namespace) -> dict[str, Any]:
    return {
        name: getattr(options, name) for name in _SHORT_FOR if getattr(options, name) is not None
    }


def _write_difference(found: Evaluation, options: argparse.Namespace) -> None:
    from phase_ppl.evaluation.evaluation import difference_table

    difference = found.against(options.against)
    print(f"\n{difference_table(difference)}")
    if found.folder is not None:
        write_json(found.folder.path / AGAINST, difference)


def _draw(folder: ResultsFolder, options: argparse.Namespace) -> list[str]:
    """Draw figures and pages; return in words what could not be drawn."""
    from phase_ppl.evaluation.figures import draw_figures
    from phase_ppl.evaluation.folder import PAGE
    from phase_ppl.evaluation.report import contents, write_page
    from phase_ppl.inference.runs.progress import counted

    problems = []
    try:
        draw_figures(folder, folder.path, progress=not options.quiet)
    except Exception as error:  # the results are there, whatever becomes of their pictures
        problems.append(f"the figures cannot be drawn: {one_line(error)}")
    finished = [event.id for event in folder.events if folder.is_finished(event.id)]
    for event_id in counted(finished, shows_progress(options), "page", "drawing"):
        try:
            page = contents.page_in_folder(folder, event_id)
            write_page(page, folder.folder_of(event_id) / PAGE)
        except Exception as error:
            problems.append(f"the page of {event_id} cannot be drawn: {one_line(error)}")
    return problems
