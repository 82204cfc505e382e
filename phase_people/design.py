"""Designs of studies: events whose answers distinguish models, priors or observers."""

from __future__ import annotations

import inspect
import os
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any, TypeAlias

import numpy as np
import xarray as xr

import phase_ppl as ppl
from phase_people.answers import Made, evidence_of
from phase_people.fit import FittedObserver
from phase_people.fit_people import asked_about
from phase_people.information import LAPSE, Design, checked
from phase_people.observers import FloatArray

Candidate: TypeAlias = (
    "str | os.PathLike[str] | ppl.Model | ppl.Evaluation | FittedObserver | Callable[..., Any] "
    "| Mapping[str, Any]"
)
"""Anything that can be compared, see :func:`design`."""


def design(
    events: str | os.PathLike[str] | Sequence[ppl.Event],
    models: Mapping[str, Candidate] | Sequence[str],
    question: str = "relation",
    *,
    source: Candidate = "closed_loop",
    answers: int = 1,
    lapse: float = LAPSE,
    prior: Mapping[str, float] | None = None,
    seed: int = 0,
    workers: int | None = None,
    progress: bool | None = None,
    **options: Any,
) -> Design:
    """Return how much people's answers are expected to tell which of several models is right.

    People are assumed to answer as one of the models predicts. The expected information is the
    mutual information between this model and people's answers, in nats. For one answer it is the
    Jensen-Shannon divergence of the models' predictions. The information's error is NaN (printed
    ``unknown``) if some prediction has no error; predictions of exact models have errors of 0.

    Args:
        events: an event file, a folder of event files or of a generated data set, or events.
        models: label -> model, at least two; a list of names has the names as labels. Models of
            one kind predict by themselves: a name (:func:`phase_ppl.available_models`), a
            :class:`phase_ppl.Model`, a function ``(scene, observation, seed)``, an evaluation or
            its folder, or event id -> posterior or prediction. Models of another kind change the
            posteriors of ``source``: a prior, by name or as a program, or a fitted observer.
        question: "relation", "goal_red" or "goal_green"; in other worlds than PHASE a question of
            :func:`phase_ppl.questions_of`. If every model gives posteriors, any other quantity with
            categories.
        source: what gives the posteriors for priors and observers: a model of the first kind. It is
            asked once. Stored posteriors save that time: an evaluation or its folder, or event id
            -> posterior.
        answers: number of people who are asked about each event.
        lapse: probability that a person answers at random.
        prior: label -> prior probability of that model, to be normalised; by default all are equal.
        seed: seed of the models, and of the simulated answers that estimate joint information.
        workers, progress, **options: passed to :func:`phase_ppl.evaluate` when a model is asked.

    Example:
        ``found = ppl.design(events, ["uniform", "sparse_social"], source="runs")``, then
        ``found.best(5)`` and ``found.plot()``

    Raises:
        InvalidSettingError, UnknownNameError: a model, question or setting cannot be used.
        InvalidEventError: events cannot be read, or a model failed at an event.
    """
    chosen = ppl.all_events(events)
    named = models if isinstance(models, Mapping) else {name: name for name in models}
    given = {str(label): one for label, one in named.items()}
    if isinstance(models, str) or len(given) < 2:
        raise ppl.errors.InvalidSettingError(
            f"models={ppl.errors.shown(models)}, expected at least two to compare"
        )
    kinds = {label: _kind(label, one) for label, one in given.items()}
    asking = {"workers": workers, "progress": progress, "seed": seed, **options}
    base: Mapping[str, Made] | None = None
    if {"prior", "observer"} & {*kinds.values()}:
        if _kind("source", source) in ("prior", "observer"):
            raise ppl.errors.InvalidSettingError(
                f"source={ppl.errors.shown(source)}, expected a source of posteriors, such as "
                "'closed_loop'"
            )
        base = asked_about(chosen, source, **asking)
    rows: list[list[FloatArray]] = []
    labels: tuple[str, ...] = ()
    for label, one in given.items():
        made: Mapping[str, Made]
        if isinstance(one, FittedObserver):
            made = one.predict(evidence_of(chosen, base))
        elif kinds[label] == "prior":
            assert base is not None
            made = _under(label, one, chosen, base, progress)
        else:
            made = asked_about(chosen, one, **asking)
        rows.append([])
        for event in chosen:
            found_labels, found = _predicted(label, question, event.id, made)
            if labels and labels != found_labels:
                raise ppl.errors.InvalidSettingError(
                    f"{label} has other answers to {question} than others"
                )
            labels = found_labels
            rows[-1].append(found)
    dims = ("model", "event", "answer")
    values, errors = np.moveaxis(np.array(rows), 2, 0).copy()
    coords = {"model": [*given], "event": [event.id for event in chosen], "answer": list(labels)}
    table = xr.DataArray(values, {**coords, "error": (dims, errors)}, dims, name="probability")
    return checked(table, question, answers=answers, lapse=lapse, prior=prior, seed=seed)


def _kind(label: str, one: object) -> str:
    """Return "model", "prior" or "observer"."""
    if isinstance(one, FittedObserver):
        return "observer"
    if isinstance(one, ppl.Model | ppl.Evaluation | Mapping | os.PathLike):
        return "model"
    if isinstance(one, str):
        if Path(one).is_dir() or one in ppl.available_models():
            return "model"
        if one in ppl.priors.available():
            return "prior"
        known = [*ppl.available_models(), *ppl.priors.available()]
        raise ppl.errors.unknown_name(f"model or prior of {label!r}", one, known)
    if not callable(one):
        raise ppl.errors.InvalidSettingError(
            f"{label}={ppl.errors.shown(one)} is no model, prior or fitted observer"
        )
    try:
        inspect.signature(one).bind()
    except TypeError:
        return "model"  # a function of scene, observation and seed
    return "prior"


def _under(
    label: str,
    prior: Any,
    events: Sequence[ppl.Event],
    base: Mapping[str, Made],
    progress: bool | None,
) -> dict[str, Made]:
    """Return event id -> its posterior under another prior."""
    found: dict[str, Made] = {}
    for event in ppl.counted(events, progress, "event", label):
        post = base.get(event.id)
        if not isinstance(post, ppl.Posterior | ppl.ClosedLoopPosterior):
            raise ppl.errors.InvalidSettingError(
                f"{label} is a prior, for which the source must have a posterior of {event.id!r}"
            )
        try:
            found[event.id] = post.with_prior(prior)
        except ppl.PhasePPLError as error:
            raise type(error)(f"{label}, {event.id}: {error}") from None
    return found


def _predicted(
    label: str, question: str, event: str, made: Mapping[str, Made]
) -> tuple[tuple[str, ...], FloatArray]:
    """Return the answers to a question about an event, their probabilities and errors (2, n)."""
    one = made.get(event)
    if isinstance(one, ppl.Posterior | ppl.ClosedLoopPosterior):
        marginal = one.marginal(question)
        names = tuple(str(name) for name in marginal[question].values)
        return names, np.stack([marginal.values, marginal["error"].values])
    if not isinstance(one, ppl.Prediction):
        raise ppl.errors.InvalidSettingError(f"{label} says nothing of the event {event!r}")
    if question not in one.questions:
        what = f"question to {label}, which has predictions only:"
        raise ppl.errors.unknown_name(what, question, one.questions)
    if question not in one.probabilities:
        raise ppl.errors.InvalidSettingError(
            f"{label} has no probabilities of {question} for {event!r}"
        )
    shares = one.probabilities[question]
    errors = one.errors.get(question, np.full_like(shares, np.nan))
    return one.questions[question], np.stack([shares, errors])
