"""The commands ``evaluate``, ``compare-models`` and ``reproduce``."""

from __future__ import annotations

import argparse
import functools
import inspect
import re
import sys
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

import phase_ppl
from phase_ppl.agents.config import PLANNERS
from phase_ppl.cli import commands as cli
from phase_ppl.cli import own
from phase_ppl.world.errors import InvalidSettingError, OutputError, check_name
from phase_ppl.world.event import Event
from phase_ppl.world.files import writable_folder, write_json

if TYPE_CHECKING:
    from phase_ppl.evaluation.comparison import ModelComparison
    from phase_ppl.evaluation.evaluation import Evaluation, ResultsFolder

AGAINST: Final = "against.json"
"""The file in the folder of results that holds the differences from another model."""

_OWN: Final = ("kernel", "prior", "simulator")
_SHORT_FOR: Final = ("preset", "planner", *_OWN, "budget", "weights")
"""Options of models that have options of the command of their own."""

_OF_WORK: Final = (
    *("model", "observer", "resume", "split", "limit", "seed"),
    *("judgments", "option", "stored"),
    *_SHORT_FOR,
)
"""Options that say nothing where an evaluation is only shown again."""

_NOTHING_SAVED: Final = "\nNothing was saved; --out DIR keeps predictions, metrics and figures."

_JUDGMENTS: Final = "people's judgments: a .csv file, or a folder of raters' files"

_LABEL: Final = re.compile(r"[A-Za-z0-9][A-Za-z0-9_-]*")


def add_to(commands: Any) -> None:
    """Add the commands."""
    _add_compare_models(commands)
    _add_reproduce(commands)
    parser = cli.command(
        commands,
        "evaluate",
        _evaluate,
        "phase-ppl evaluate videos.json --model simple --planner fast --out out",
        "Ask a model about many events, longest first, and score what it answers. "
        "Without EVENTS, the evaluation in --out is read and shown again, to be compared by "
        "--against.",
    )
    says = "an event file, a folder of event files, or a bundled event's name"
    cli.add(parser, "events EVENTS", says, nargs="?")
    says = (
        "stepwise, the closed loop (the default), simple or another; given several times, all are "
        "evaluated, each in a folder of its name in --out, and compared; LABEL=NAME gives another "
        "name"
    )
    cli.add(parser, "--model NAME", says, action="append")
    cli.add(parser, "--out DIR", "for predictions, metrics, figures and pages", Path)
    cli.add(
        parser, "--resume", "go on with what is in --out; events may have been added at the end"
    )
    says = (
        "through whom the model is seen: people, who come with the package, or a file of fit-people"
    )
    cli.add(parser, "--observer NAME", says)
    cli.add(parser, "--split NAME", "of a generated set, such as test")
    cli.add(parser, "--limit N", "the first N events only", cli.whole(1))
    cli.share(parser, "workers", "dask")
    cli.add(parser, "--seed N", "default 0", cli.whole(0))
    cli.add(parser, "--judgments FILE", _JUDGMENTS, Path)
    says = (
        "results of another model, or a model whose predictions the events carry, for "
        f"paired differences; written to {AGAINST}. With several models: the one of them from "
        "which the others' differences are wanted; default: every pair"
    )
    cli.add(parser, "--against DIR", says)
    add_references(parser)
    model = parser.add_argument_group(
        "options of the model; of several models, of all that take them"
    )
    cli.add(model, "--preset NAME", cli.PRESET)
    cli.add(model, "--planner", choices=PLANNERS)
    cli.add(model, "--kernel NAME", own.FILE)
    cli.add(model, "--prior NAME", own.FILE)
    cli.add(model, "--simulator FILE.py:NAME", "runs that file")
    cli.add(model, "--budget B", cli.BUDGET, cli.budget)
    cli.add(model, "--weights NAME")
    says = (
        "any other, such as chains=15 or rule=paper, or of one of several models, such as "
        "simple.chains=15; may be given several times"
    )
    cli.add_options(model, says, _option)
    cli.add(parser, "--no-figures", "draw no figures and pages")
    cli.share(parser, "progress")


def _option(text: str) -> tuple[str, Any]:
    """Return name and value of NAME=VALUE or MODEL.NAME=VALUE."""
    label, dot, _ = text.partition("=")[0].rpartition(".")
    name, value = cli.named_value(text.removeprefix(f"{label}{dot}"))
    return f"{label}{dot}{name}", value


def models_of(given: Sequence[str] | None) -> dict[str, str]:
    """Return label -> model of ``--model NAME`` or ``LABEL=NAME``; the closed loop by default."""
    found: dict[str, str] = {}
    for text in given or ["stepwise"]:
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
    """
    from phase_ppl.evaluation.registry import model_info

    taken = inspect.signature(phase_ppl.evaluate).parameters
    shared = dict(plain)
    of_one: dict[str, dict[str, Any]] = {label: {} for label in models}
    for text, value in named:
        label, dot, name = text.rpartition(".")
        if dot:
            check_name(f"model in --option {text}:", label, models)
        place = of_one[label] if dot else shared
        if name in place or name in taken:
            why = "given twice" if name in place else "no option of a model"
            raise InvalidSettingError(f"--option {text}: {why}")
        place[name] = value
    if len(models) == 1:
        return {label: {**shared, **given} for label, given in of_one.items()}
    found: dict[str, dict[str, Any]] = {label: {} for label in models}
    for name, value in shared.items():
        takers = [
            label
            for label, model in models.items()
            if model_info(model).takes(name, {**shared, **of_one[label]})
        ]
        if not takers:
            raise InvalidSettingError(f"{name}: none of the models {', '.join(models)} takes it")
        for label in takers:
            found[label][name] = value
    return {label: {**found[label], **given} for label, given in of_one.items()}


def _evaluate(options: argparse.Namespace) -> int:
    if options.events is None:
        return _show_again(options)
    from phase_ppl.evaluation.judgments import all_events, load_judgments

    models = models_of(options.model)
    labelled = len(models) > 1 or list(models) != list(models.values())  # each has a folder
    if options.resume and options.out is None:
        raise InvalidSettingError("--resume needs --out, the folder to go on in")
    plain = cli.given(options, *_SHORT_FOR)
    for name in plain.keys() & {*_OWN}:
        plain[name] = own.taken(plain[name], name, named=name != "simulator")
    of_models = options_of(models, plain, options.option)
    events = all_events(options.events, options.split)
    if options.judgments is not None:
        options.judgments = load_judgments(options.judgments, events)
        if options.judgments.summary:
            print(f"people: {options.judgments.summary}")
    if labelled:
        _check_several(options, events, models, of_models)
    else:
        _check_one(options, events)
    if options.out is not None:
        writable_folder(options.out)

    code = 0
    found: dict[str, Evaluation] = {}
    for label, model in models.items():
        named = f"{label}: " if labelled else ""
        out = options.out / label if labelled and options.out is not None else options.out
        evaluation = _evaluation(options, events, model, out, of_models[label], named)
        if evaluation is None:
            return cli.INTERRUPTED
        if labelled:
            for event, failure in evaluation.failures.items():
                print(f"{label}: failed: {event}: {failure}", file=sys.stderr)
        else:
            print(evaluation)
        problems = []
        if evaluation.folder is not None and not options.no_figures:
            problems = _draw(evaluation, evaluation.folder, options)
        for problem in problems:
            print(f"phase-ppl: error: {named}{problem}", file=sys.stderr)
        if problems or evaluation.failures:
            code = cli.FAILED
        found[label] = evaluation
    if not labelled:
        (alone,) = found.values()
        _end_of_one(alone, options)
        return code
    comparison = phase_ppl.compare_models(
        found, stored=named_references(options.stored), against=options.against
    )
    print(comparison)
    if options.out is None:
        print(_NOTHING_SAVED)
        return code
    return keep(comparison, options.out, options) or code


def _evaluation(
    options: argparse.Namespace,
    events: Sequence[Event],
    model: str,
    out: Path | None,
    of_model: Mapping[str, Any],
    named: str,
) -> Evaluation | None:
    """Evaluate one model, ``named`` in messages; None where it was interrupted."""
    try:
        # the events are those of the split already
        more = dict(of_model, events=events, model=model, out=out, split=None)
        return phase_ppl.evaluate(**cli.arguments(phase_ppl.evaluate, options, **more))
    except phase_ppl.EvaluationInterrupted as stopped:
        print(f"phase-ppl: {named}{stopped}", file=sys.stderr)
        if out is not None:
            print("Go on with the same command and --resume", file=sys.stderr)
        return None
    except phase_ppl.PhasePPLError as error:
        kept: Evaluation | None = getattr(error, "evaluation", None)
        if named and kept is not None and isinstance(error, phase_ppl.errors.AnswerError):
            return kept  # other models may do better
        hint = "; --resume goes on" if out is not None and kept is not None else ""
        raise type(error)(f"{named}{error}{hint}") from None


def _check_one(options: argparse.Namespace, events: Sequence[Event]) -> None:
    """Find out what is wrong with ``--against`` before the model is asked."""
    from phase_ppl.evaluation.evaluation import opponent

    if options.stored:
        raise InvalidSettingError("--stored is for several models; --against compares with one")
    if options.against is not None:
        opponent(events[: options.limit], options.against)


def _check_several(
    options: argparse.Namespace,
    events: Sequence[Event],
    models: Mapping[str, str],
    of_models: Mapping[str, Mapping[str, Any]],
) -> None:
    """Find out what is wrong before the first model is asked."""
    from phase_ppl.evaluation.answer_sets import reference_label
    from phase_ppl.evaluation.comparison import check_names, chosen_references
    from phase_ppl.evaluation.evaluate import settings_of
    from phase_ppl.evaluation.evaluation import SETTINGS, ResultsFolder, holds_predictions
    from phase_ppl.evaluation.prediction import reference_predictions
    from phase_ppl.evaluation.registry import ready

    check_names(list(models))
    chosen = events[: options.limit]
    for label, model in models.items():
        asked = ready(model, of_models[label])
        if options.resume and holds_predictions(options.out / label):
            settings = settings_of(asked, options.seed or 0, chosen)
            ResultsFolder.open(options.out / label).check_same(settings)
    references = chosen_references(named_references(options.stored), reference_predictions(chosen))
    known = [*models, *(reference_label(name, models) for name in references)]
    if options.against is not None:
        check_name("model to compare with", options.against, known)
    if options.out is None:
        return
    if (options.out / SETTINGS).is_file():
        raise OutputError(f"--out {options.out} holds an evaluation of one model: name another")
    for label in models:
        if holds_predictions(options.out / label) and not options.resume:
            raise OutputError(
                f"{options.out / label} already holds an evaluation; --resume goes on"
            )


def _show_again(options: argparse.Namespace) -> int:
    """Show an evaluation that is there."""
    given = cli.given(options, *_OF_WORK)
    of_work = [f"--{name}" for name, v in given.items() if v is not False and v != []]
    if options.out is None or of_work:
        needed = f" with {', '.join(of_work)}" if of_work else ""
        raise InvalidSettingError(
            f"EVENTS is missing{needed}; only to show the evaluation in --out again needs none"
        )
    found = phase_ppl.Evaluation.load(options.out)
    print(found)
    _end_of_one(found, options)
    return cli.FAILED if found.failures else 0


def _end_of_one(found: Evaluation, options: argparse.Namespace) -> None:
    """Say where an evaluation is kept, and how it differs from another."""
    from phase_ppl.evaluation.evaluation import difference_table

    folder = None if found.folder is None else found.folder.path
    print(_NOTHING_SAVED if folder is None else f"\nKept in {folder}\n{cli.report_hint(folder)}")
    if options.against is None:
        return
    difference = found.against(options.against)
    print(f"\n{difference_table(difference)}")
    if folder is not None:
        write_json(folder / AGAINST, difference)


def _draw(evaluation: Evaluation, folder: ResultsFolder, options: argparse.Namespace) -> list[str]:
    """Draw figures and pages; return in words what could not be drawn."""
    from phase_ppl.evaluation.evaluation import PAGE
    from phase_ppl.evaluation.report import page_of, write_page

    def draw_page(event_id: str) -> None:
        page = page_of(evaluation, event_id)
        write_page(page, folder.folder_of(event_id) / PAGE)

    return drawn(evaluation, folder.path, list(evaluation.predictions), draw_page, options)


# --- several models side by side ------------------------------------------------------------------

PAGES: Final = "pages"  # the folder of the pages, one per event, in that of a comparison
_PAGE: Final = "[0-9][0-9][0-9][0-9]-*.html"  # what pages are called (``entry_name``)


def _add_compare_models(commands: Any) -> None:
    """Add the command."""
    parser = cli.command(
        commands,
        "compare-models",
        _compare_models,
        "phase-ppl compare-models out/simple out/last_frame --out compared",
        "Compare evaluations of several models, and people, on the same events: "
        "accuracy, agreement with people, paired differences with Holm's correction, equivalence "
        "with people, cost.",
    )
    says = "written by evaluate --out, of one model or of several; NAME=DIR gives it a name"
    cli.add(parser, "folders DIR", says, nargs="+")
    add_references(parser)
    cli.add(parser, "--against NAME", "differences from this model only; default: every pair")
    cli.add(parser, "--common", "compare on the events that all folders share")
    says = "difference of shares up to which a model and people are equivalent; default 0.1"
    cli.add(parser, "--margin M", says, float)
    cli.add(parser, "--seed N", "of the resamples; default 0", cli.whole(0))
    cli.add(parser, "--resamples N", "of the events, default 10000", cli.whole(1))
    cli.add(parser, "--out DIR", "for tables, figures and pages", Path)
    cli.add(parser, "--no-figures", "draw no figures and pages")
    cli.share(parser, "progress")


def add_references(parser: argparse.ArgumentParser) -> None:
    """Add the option that names reference models."""
    says = (
        "a reference model, whose answers the events carry, to be compared too, or all; may "
        "be given several times"
    )
    cli.add(parser, "--stored NAME", says, action="append", default=[])


def _compare_models(options: argparse.Namespace) -> int:
    from phase_ppl.evaluation.evaluation import SETTINGS

    if options.out is not None:
        if (options.out / SETTINGS).is_file():
            raise InvalidSettingError(f"--out {options.out} holds an evaluation: name another")
        writable_folder(options.out)
    found = phase_ppl.compare_models(
        _sources(options.folders),
        **cli.arguments(phase_ppl.compare_models, options, stored=named_references(options.stored)),
    )
    print(found)
    if options.out is None:
        print("\nNothing was saved; --out DIR keeps tables and figures.")
        return 0
    return keep(found, options.out, options)


def named_references(given: Sequence[str]) -> str | list[str]:
    """Return what ``compare_models`` takes for the reference models named by ``--stored``."""
    from phase_ppl.evaluation.comparison import ALL

    return ALL if ALL in given else list(given)


def _sources(given: Sequence[str]) -> dict[str, Any] | list[str]:
    """Return the folders, with names where there are some."""
    pairs = [(text, "") if Path(text).exists() else text.partition("=")[::2] for text in given]
    named = {name: folder for name, folder in pairs if folder}
    if not named:
        return list(given)
    if len(named) < len(given) or "" in named:
        raise InvalidSettingError(
            f"{' '.join(given)}: expected a different name for each, as in one=DIR other=DIR"
        )
    return named


def keep(found: ModelComparison, out: Path, options: argparse.Namespace) -> int:
    """Write a comparison with its figures and pages; return the exit code."""
    from phase_ppl.evaluation.evaluation import entry_name
    from phase_ppl.evaluation.report import event_page, write_page

    found.save(out)
    problems = []
    if not options.no_figures:
        pages = writable_folder(out / PAGES)
        for old in pages.glob(_PAGE):  # of an earlier comparison, perhaps of other events
            old.unlink(missing_ok=True)
        events = {event.id: (place, event) for place, event in enumerate(found.events)}

        def draw_page(event_id: str) -> None:
            place, event = events[event_id]
            page = event_page(event, found.answers)
            write_page(page, pages / f"{entry_name(place, event_id)}.html")

        problems = drawn(found, out, list(events), draw_page, options)
    for problem in problems:
        print(f"phase-ppl: error: {problem}", file=sys.stderr)
    print(f"\nKept in {out}\n{cli.report_hint(out)}")
    return cli.FAILED if problems else 0


def drawn(
    source: Any,
    out: Path,
    events: Sequence[str],
    draw_page: Callable[[str], None],
    options: argparse.Namespace,
) -> list[str]:
    """Draw the figures of an evaluation or a comparison into ``out``, and the events' pages.

    The results are there, whatever becomes of their pictures: what could not be drawn is
    returned in words.
    """
    from phase_ppl.evaluation.figures import draw_figures
    from phase_ppl.world.progress import counted

    problems = []
    try:
        draw_figures(source, out, progress=not options.quiet)
    except Exception as error:
        problems.append(f"the figures cannot be drawn: {cli.one_line(error)}")
    for event_id in counted(events, cli.shows_progress(options), "page", "drawing"):
        try:
            draw_page(event_id)
        except Exception as error:
            problems.append(f"the page of {event_id} cannot be drawn: {cli.one_line(error)}")
    return problems


# --- reproduce ------------------------------------------------------------------------------------


def _add_reproduce(commands: Any) -> None:
    parser = cli.command(
        commands,
        "reproduce",
        _reproduce,
        "phase-ppl reproduce --videos test.json --profile quick --out paper",
        "Run the models of the paper, and hold every number and figure of it against what comes "
        "out, on one page. Without --videos it is a try on generated events, no reproduction.",
    )
    cli.add(parser, "--videos FILE", "phase-test JSON or the authors' release", Path)
    cli.add(parser, "--out DIR", type=Path, required=True)
    says = (
        "quick (the default): few simulations and searches; paper: as the paper has it; "
        "full: and all lesions, and what is beyond the paper"
    )
    cli.add(parser, "--profile", says, choices=("quick", "paper", "full"), default="quick")
    cli.add(parser, "--judgments FILE", _JUDGMENTS, Path)
    cli.add(parser, "--vlm-store DIR", "stored answers of a vision-language model", Path)
    cli.add(parser, "--tags FILE", "people's labels, a .csv file", Path)
    cli.add(parser, "--likeness FILE", "people's ratings of likeness, a .csv file", Path)
    says = "a file or folder of events that people steered, with judgments in them"
    cli.add(parser, "--steered EVENTS", says, Path)
    cli.share(parser, "seed")
    cli.add(parser, "--resume", "go on with what is in DIR")
    cli.share(parser, "workers", "progress")


def _reproduce(options: argparse.Namespace) -> int:
    from phase_ppl.evaluation.reproduce import PAGE, RESULT

    say = functools.partial(print, file=sys.stderr, flush=True)
    try:
        made = phase_ppl.reproduce(**cli.arguments(phase_ppl.reproduce, options, say=say))
    except KeyboardInterrupt:
        say("phase-ppl: interrupted; go on with the same command and --resume")
        return cli.INTERRUPTED
    print(made)
    print(f"\nWritten to {made.folder}: {PAGE}, {RESULT}")
    return 0
