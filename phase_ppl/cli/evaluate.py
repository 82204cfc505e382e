"""The commands ``evaluate``, ``compare-models`` and ``reproduce``."""

from __future__ import annotations

import functools
import shlex
import sys
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

import phase_ppl
from phase_ppl.cli import users_parts
from phase_ppl.cli.commands import FAILED, INTERRUPTED, Options
from phase_ppl.world.errors import AnswerError, InvalidSettingError, OutputError, check_name
from phase_ppl.world.event import Event
from phase_ppl.world.files import writable_folder

if TYPE_CHECKING:
    from phase_ppl.evaluation.comparison import ModelComparison
    from phase_ppl.evaluation.evaluation import Evaluation

_SHORT_FOR: Final = ("preset", "planner", "kernel", "prior", "simulator", "budget", "weights")
"""Options of models that are options of the command."""


def evaluate(options: Options) -> int:
    """Ask a model about many events, and score its answers.

    The longest events come first. The last options are the model's; with several models, they go to
    all that take them.

    Args:
        EVENTS: an event file, a folder of event files, or a bundled event's name
        --model NAME...: stepwise, the closed loop (the default), simple or another. Given several
            times, all are evaluated and compared, each in a folder of its name in --out;
            LABEL=NAME gives another name
        --out DIR: for predictions and metrics; report makes a page of them, with figures
        --resume: continue the evaluation in --out; events may have been added at the end
        --observer NAME: observer through which the model is seen: people, which comes with the
            package, or a file of fit-people
        --split NAME: of a generated set, such as test
        --limit N: the first N events only
        $cluster
        $seed
        --judgments FILE: people's judgments: a .csv file, or a folder of raters' files
        --against NAME: of several models the one to compare the others with; default: every pair
        $stored
        $progress
        --preset NAME: $PRESET
        $planner
        --kernel NAME: $FILE
        --prior NAME: $FILE
        --simulator FILE.py:NAME: runs that file
        --budget B: $BUDGET
        --weights NAME: of SIMPLE's posteriors; of SocialGNN its folder
        --option NAME=VALUE...: any other option, such as chains=15 or rule=paper; for one of
            several models, such as simple.chains=15; may be given several times

    example: phase-ppl evaluate videos.json --model simple --planner fast --out out
    """
    models = users_parts.models_of(options.model)
    labelled = len(models) > 1 or list(models) != list(models.values())  # each has a folder
    if options.resume and options.out is None:
        raise InvalidSettingError("--resume needs --out, the folder to go on in")
    plain = options.given(*_SHORT_FOR)
    for name in plain.keys() & {"kernel", "prior", "simulator"}:
        plain[name] = users_parts.taken(plain[name], name, named=name != "simulator")
    if "client" in options.option:  # of the model vlm
        client = options.option.pop("client")
        plain["client"] = users_parts.taken(str(client), "client", named=False)
    of_models = users_parts.options_of(models, plain, options.option)
    events = phase_ppl.all_events(options.events, options.split)
    if options.judgments is not None:
        options.judgments = phase_ppl.load_judgments(options.judgments, events)
        print(f"people: {options.judgments}")
    if labelled:
        _check_several(options, events, models, of_models)
    elif options.stored or options.against is not None:
        raise InvalidSettingError(
            "--stored and --against are for several models; compare-models compares folders"
        )
    if options.out is not None:
        writable_folder(options.out)

    code = 0
    found: dict[str, Evaluation] = {}
    for label, model in models.items():
        named = f"{label}: " if labelled else ""
        out = options.out / label if labelled and options.out is not None else options.out
        asked = {"events": events, "model": model, "out": out, **of_models[label]}
        try:
            evaluation = found[label] = options.call(phase_ppl.evaluate, **asked)
        except phase_ppl.EvaluationInterrupted as stopped:
            again = "; go on with the same command and --resume" if out is not None else ""
            print(f"phase-ppl: {named}{stopped}{again}", file=sys.stderr)
            return INTERRUPTED
        except phase_ppl.PhasePPLError as error:
            kept = getattr(error, "evaluation", None)
            if not (named and kept is not None and isinstance(error, AnswerError)):
                hint = "; --resume goes on" if out is not None and kept is not None else ""
                raise type(error)(f"{named}{error}{hint}") from None
            evaluation = found[label] = kept  # other models may succeed
        if labelled:
            for event, failure in evaluation.failures.items():
                print(f"{label}: failed: {event}: {failure}", file=sys.stderr)
        else:
            print(evaluation)
        if evaluation.failures:
            code = FAILED
    if not labelled:
        _say_where(None if evaluation.folder is None else evaluation.folder.path)
        return code
    stored = _references(options)
    comparison = phase_ppl.compare_models(found, stored=stored, against=options.against)
    _keep(comparison, options)
    return code


def _check_several(
    options: Options,
    events: Sequence[Event],
    models: Mapping[str, str],
    of_models: Mapping[str, Mapping[str, Any]],
) -> None:
    """Check several models before the first is asked."""
    from phase_ppl.evaluation.comparison import check_names, reference_label
    from phase_ppl.evaluation.evaluate import settings_of
    from phase_ppl.evaluation.evaluation import chosen_references
    from phase_ppl.evaluation.folder import SETTINGS, ResultsFolder, holds_predictions
    from phase_ppl.evaluation.prediction import reference_predictions
    from phase_ppl.evaluation.registry import ready

    check_names(list(models))
    chosen = events[: options.limit]
    if options.out is not None and (options.out / SETTINGS).is_file():
        raise OutputError(f"--out {options.out} holds an evaluation of one model: name another")
    for label, model in models.items():
        asked = ready(model, of_models[label])
        if options.out is None or not holds_predictions(options.out / label):
            continue
        if not options.resume:
            raise OutputError(
                f"{options.out / label} already holds an evaluation; --resume goes on"
            )
        settings = settings_of(asked, options.seed or 0, chosen)
        ResultsFolder.open(options.out / label).check_same(settings)
    references = chosen_references(_references(options), reference_predictions(chosen))
    known = [*models, *(reference_label(name, models) for name in references)]
    if options.against is not None:
        check_name("model to compare with", options.against, known)


def _say_where(folder: Path | None) -> None:
    if folder is None:
        print("\nNothing was saved; --out DIR keeps tables.")
    else:
        hint = f"For one page of it all, with figures: phase-ppl report {shlex.quote(str(folder))}"
        print(f"\nKept in {folder}\n{hint}")


def _references(options: Options) -> str | list[str]:
    """Return the reference models of ``--stored``, as ``compare_models`` takes them."""
    return "all" if "all" in options.stored else list(options.stored)


def compare_models(options: Options) -> None:
    """Compare evaluations of several models, and people, on the same events.

    Prints accuracy, agreement with people, paired differences with Holm's correction,
    equivalence with people, and cost.

    Args:
        FOLDERS...: written by evaluate --out, of one model or of several; NAME=DIR gives it a name
        $stored
        --against NAME: differences from this model only; default: every pair
        --common: compare on the events that all folders share
        --margin X: largest difference of shares at which a model equals people; default 0.1
        --seed N: of the resamples; default 0
        --resamples N: of the events, default 10000
        --out DIR: for tables; report makes a page of them, with figures
        $progress

    example: phase-ppl compare-models out/simple out/last_frame --out compared
    """
    from phase_ppl.evaluation.folder import SETTINGS

    if options.out is not None:
        if (options.out / SETTINGS).is_file():
            raise InvalidSettingError(f"--out {options.out} holds an evaluation: name another")
        writable_folder(options.out)
    sources = _sources(options.folders)
    found = options.call(phase_ppl.compare_models, sources=sources, stored=_references(options))
    _keep(found, options)


def _sources(given: Sequence[str]) -> dict[str, str] | list[str]:
    """Return the folders, by name if names are given."""
    named = dict(text.split("=", 1) for text in given if "=" in text and not Path(text).exists())
    if not named:
        return list(given)
    if len(named) < len(given) or not all(named) or not all(named.values()):
        raise InvalidSettingError(
            f"{' '.join(given)}: expected a different name for each, as in one=DIR other=DIR"
        )
    return named


def _keep(found: ModelComparison, options: Options) -> None:
    """Print a comparison, and write it."""
    print(found)
    if options.out is not None:
        found.save(options.out)
    _say_where(options.out)


def reproduce(options: Options) -> None:
    """Reproduce the numbers that the paper prints, cell by cell.

    Runs the models of the paper, and compares every number with the results.

    Args:
        --videos FILE: phase-test JSON or the authors' release; required
        --out DIR: required
        --profile quick|paper: quick (the default): few simulations and searches; paper: as in the
            paper
        --judgments FILE: people's judgments: a .csv file, or a folder of raters' files
        --vlm DIR: answers of a vision-language model, by evaluate --model vlm --out DIR
        --steered FILE: a file or folder of events that people steered, with judgments in them
        $seed
        --resume: continue the run in DIR
        $workers
        $progress

    example: phase-ppl reproduce --videos test.json --profile quick --out paper
    """
    from phase_ppl.evaluation.reproduce import COMPARED, RESULT, TABLE

    say = functools.partial(print, file=sys.stderr, flush=True)
    made = options.call(phase_ppl.reproduce, say=say)
    print(made)
    print(f"\nWritten to {made.folder}: {RESULT}, {TABLE}, {COMPARED}/report.html")
