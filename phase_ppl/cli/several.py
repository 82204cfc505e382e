"""Several models in one ``evaluate``: which there are, their options, and their comparison."""

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
    from phase_ppl.evaluation.comparison.contenders import check_names, stored_label, stored_names
    from phase_ppl.evaluation.folder import SETTINGS, holds_predictions
    from phase_ppl.evaluation.references import reference_predictions
    from phase_ppl.evaluation.registry import ready
    from phase_ppl.evaluation.resuming import check_resumable, settings_of

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
