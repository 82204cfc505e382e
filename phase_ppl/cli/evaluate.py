"""The commands ``evaluate``, ``compare-models`` and ``reproduce``."""

from __future__ import annotations

import functools
import inspect
import shlex
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import Any, Final

import phase_ppl
from phase_ppl.cli import users_parts
from phase_ppl.cli.commands import FAILED, INTERRUPTED, Options
from phase_ppl.world.errors import InvalidSettingError
from phase_ppl.world.files import writable_folder

_SHORT_FOR: Final = ("preset", "planner", "kernel", "prior", "simulator", "budget", "weights")
"""Options of models that are options of the command."""


def evaluate(options: Options) -> int:
    """Ask a model about many events, and score its answers.

    The longest events come first. The last options are the model's. compare-models compares the
    folders of several.

    Args:
        EVENTS: an event file, a folder of event files, or a bundled event's name
        --model NAME: closed_loop, the closed loop (the default), simple or another
        --out DIR: for predictions and metrics; report makes a page of them, with figures
        --resume: continue the evaluation in --out; events may have been added at the end
        --observer NAME: observer through which the model is seen: people, which comes with the
            package, or a file of fit-people
        --split NAME: of a generated set, such as test
        --limit N: the first N events only
        $cluster
        $seed
        --judgments FILE: people's judgments: a .csv file, or a folder of raters' files
        $progress
        --preset NAME: $PRESET
        $planner
        --kernel NAME: $FILE
        --prior NAME: $FILE
        --simulator FILE.py:NAME: runs that file
        --budget B: $BUDGET
        --weights NAME: of SIMPLE's posteriors; of SocialGNN its folder
        --option NAME=VALUE...: any other option, such as chains=15 or rule=paper; may be given
            several times

    example: phase-ppl evaluate videos.json --model simple --planner fast --out out
    """
    if options.resume and options.out is None:
        raise InvalidSettingError("--resume needs --out, the folder to go on in")
    of_model = _of_model(options)
    events = phase_ppl.all_events(options.events, options.split)
    if options.judgments is not None:
        options.judgments = phase_ppl.load_judgments(options.judgments, events)
        print(f"people: {options.judgments}")
    if options.out is not None:
        writable_folder(options.out)
    try:
        evaluation = options.call(phase_ppl.evaluate, events=events, **of_model)
    except phase_ppl.EvaluationInterrupted as stopped:
        again = "" if options.out is None else "; go on with the same command and --resume"
        print(f"phase-ppl: {stopped}{again}", file=sys.stderr)
        return INTERRUPTED
    except phase_ppl.PhasePPLError as error:
        goes_on = options.out is not None and hasattr(error, "evaluation")
        raise type(error)(f"{error}{'; --resume goes on' * goes_on}") from None
    print(evaluation)
    _say_where(options.out)
    return FAILED if evaluation.failures else 0


def _of_model(options: Options) -> dict[str, Any]:
    """Return the options of the model: those of their own, and those of ``--option``."""
    found = options.given(*_SHORT_FOR)
    for name in found.keys() & {"kernel", "prior", "simulator"}:
        found[name] = users_parts.taken(found[name], name, named=name != "simulator")
    for name, value in options.option.items():
        if name in found or name in inspect.signature(phase_ppl.evaluate).parameters:
            why = "given twice" if name in found else "no option of a model"
            raise InvalidSettingError(f"--option {name}: {why}")
        of_file = name == "client"  # of the model vlm
        found[name] = users_parts.taken(str(value), name, named=False) if of_file else value
    return found


def _say_where(folder: Path | None) -> None:
    if folder is None:
        print("\nNothing was saved; --out DIR keeps tables.")
    else:
        hint = f"For one page of it all, with figures: phase-ppl report {shlex.quote(str(folder))}"
        print(f"\nKept in {folder}\n{hint}")


def compare_models(options: Options) -> None:
    """Compare evaluations of several models, and people, on the same events.

    Prints accuracy, agreement with people, paired differences with Holm's correction,
    equivalence with people, and cost.

    Args:
        FOLDERS...: written by evaluate --out, or a folder of such; NAME=DIR gives it a name
        --stored NAME...: a reference model, whose answers the events carry, to be compared too, or
            all; may be given several times
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
    stored = "all" if "all" in options.stored else options.stored
    found = options.call(phase_ppl.compare_models, sources=sources, stored=stored)
    print(found)
    if options.out is not None:
        found.save(options.out)
    _say_where(options.out)


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
