"""The call that fits an observer to people's judgments."""

from __future__ import annotations

import dataclasses
import os
import tempfile
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, TypeAlias

import phase_ppl as ppl
from phase_people.answers import Answers, Made, check_is_phase, evidence_of
from phase_people.fit import PeopleFit, as_observer, sampled
from phase_people.observers import Evidence, Perception, Program

Source: TypeAlias = (
    "str | os.PathLike[str] | ppl.Model | ppl.Evaluation | Evidence | Mapping[str, Any] | None"
)


def fit_people(
    events: str | os.PathLike[str] | Sequence[ppl.Event],
    judgments: str | os.PathLike[str] | ppl.Study | None = None,
    observer: str | Program = "company",
    *,
    source: Source = "closed_loop",
    perception: Perception | None = None,
    moments: bool = False,
    draws: int = 500,
    warmup: int = 500,
    chains: int = 2,
    seed: int = 0,
    workers: int | None = None,
    progress: bool | None = None,
    **options: Any,
) -> PeopleFit:
    """Fit an observer to people's answers by NUTS.

    If the judgments say who gave which answer, answers are modelled by rater, which takes several
    times as long as a model of the counts of answers. Response times of a study are part of the
    likelihood (:func:`~phase_people.answers.people`).

    Args:
        events: an event file, a folder of event files, or events; all of PHASE.
        judgments: a study, or a file that :func:`phase_ppl.load_judgments` reads; by default the
            judgments that the events carry.
        observer: name of a ready-made observer (``ppl.observers.OBSERVERS``), or a program as
            :mod:`phase_people.observers` describes.
        source: what gives the evidence about each event, one of five. A model, by name or as a
            :class:`phase_ppl.Model`, is asked. An evaluation or its folder has its posteriors read,
            so nothing is computed twice. A mapping event id -> posterior or prediction is used as
            it is. So is evidence (:func:`phase_ppl.evidence_from`). None: surface cues alone.
        perception: several noisy readings of each video; the model is asked about each of them.
            None: one reading, without noise.
        moments: fit to judgments made at moments of the films, not to those of whole films. Each
            moment counts as a video that ends there. So intervals are too narrow where people give
            the same answer at several moments. Response times do not count. The model must give
            posteriors of the closed loop, or predictions with these moments.
        draws, warmup: number of draws, and of warm-up steps before them, of each chain.
        chains: number of chains.
        seed: seed of the chains, of the noisy readings and of the model.
        progress: whether to show progress bars; None: only in a terminal and in notebooks.
        workers, **options: passed to :func:`phase_ppl.evaluate` when a model is asked.

    Raises:
        InvalidEventError: nobody judged any event, or events or judgments cannot be read.
        InvalidSettingError, UnknownNameError: a setting cannot be used, or events are of another
            world than PHASE.
    """
    for name, number in (("draws", draws), ("warmup", warmup), ("chains", chains)):
        ppl.errors.whole_number(name, number)
    program, name = as_observer(observer)
    everything = ppl.all_events(events)
    check_is_phase(everything[0].scene.world, "fit_people")
    study = judgments
    if study is not None and not isinstance(study, ppl.Study):
        study = ppl.load_judgments(study, everything)
    chosen = everything if study is None else ppl.with_judgments(everything, study)
    asking = {"workers": workers, "progress": progress, "seed": seed, **options}
    if moments:
        if perception is not None or isinstance(source, Evidence):
            raise ppl.errors.InvalidSettingError("moments: not with perception, nor with evidence")
        made = None if source is None else asked_about(chosen, source, **asking)
        chosen, source = _stopped(chosen, made)
        study = None
    answers = Answers.of(chosen, study)
    evidence = evidence_from(chosen, source, perception, **asking)
    found = sampled(
        program, name, evidence, answers, draws=draws, warmup=warmup, chains=chains, seed=seed,
        progress=progress,
    )  # fmt: skip
    return dataclasses.replace(found, perception=perception)


def _stopped(
    events: Sequence[ppl.Event], made: Mapping[str, Made] | None
) -> tuple[list[ppl.Event], dict[str, Made] | None]:
    """Return an event for each moment at which people judged, and what the model made of it."""
    found: list[ppl.Event] = []
    until: dict[str, Made] = {}
    for event in events:
        judged = ppl.Judgments.of(event)
        for at, then in () if judged is None else judged.moments.items():
            seen = event.observation.until(at)
            name = f"{event.id} until {at:g} s"
            stopped = dataclasses.replace(
                event, id=name, observation=seen, judgments=then.to_record(), predictions=None
            )
            found.append(stopped)
            one = None if made is None else made[event.id]
            if isinstance(one, ppl.ClosedLoopPosterior):
                until[name] = one.at(min(seen.n_frames - 1, one.frame))
            elif isinstance(one, ppl.Prediction) and at in one.moments:
                until[name] = one.at(at)
            elif made is not None:
                raise ppl.errors.InvalidSettingError(
                    f"event {event.id!r}: what the model said at {at:g} s is not known; "
                    "source='closed_loop' is known at every moment"
                )
    if not found:
        raise ppl.errors.InvalidEventError("nobody judged any of the events at a moment")
    return found, None if made is None else until


def evidence_from(
    events: Sequence[ppl.Event],
    source: Source = "closed_loop",
    perception: Perception | None = None,
    **options: Any,
) -> Evidence:
    """Return the evidence that observers have about events, in one object for all.

    Args:
        events: events of PHASE.
        source: what gives the evidence, as in :func:`fit_people`. None: surface cues alone.
        perception: noise of several readings of each video; the model is asked about each reading.
            None: no noise.
        **options: passed to :func:`phase_ppl.evaluate` when a model is asked.

    Raises:
        InvalidEventError: the model failed at an event.
        InvalidSettingError, UnknownNameError: a setting cannot be used, the source has nothing on
            an event, or an event is of another world than PHASE.
    """
    for judged_event in events:  # fails before a model is asked
        check_is_phase(judged_event.scene.world)
    if isinstance(source, Evidence):
        return source
    if source is None:
        return evidence_of(events)
    if perception is None or isinstance(source, ppl.Evaluation | Mapping) or _is_folder(source):
        return evidence_of(events, asked_about(events, source, **options))
    seed = options.get("seed", 0)
    readings = [perception.readings(e.scene, e.observation, seed) for e in events]
    made: dict[str, list[Made]] = {event.id: [] for event in events}
    for percepts in zip(*readings, strict=True):
        seen = [
            dataclasses.replace(event, observation=one)
            for event, one in zip(events, percepts, strict=True)
        ]
        for event, one in asked_about(seen, source, **options).items():
            made[event].append(one)
    return evidence_of(events, made)


def _is_folder(source: object) -> bool:
    return isinstance(source, os.PathLike) or (isinstance(source, str) and Path(source).is_dir())


def asked_about(events: Sequence[ppl.Event], source: Any, **options: Any) -> Mapping[str, Made]:
    """Return event id -> a model's posterior, or prediction.

    Args:
        events: the model is asked about them.
        source: a model, as :func:`phase_ppl.evaluate` takes it; an evaluation or its folder, whose
            posteriors are read; or the result itself.
        **options: for :func:`phase_ppl.evaluate`.
    """
    if isinstance(source, Mapping):
        return source
    if isinstance(source, ppl.Evaluation) or _is_folder(source):
        return _made(source if isinstance(source, ppl.Evaluation) else ppl.Evaluation.load(source))
    with tempfile.TemporaryDirectory() as folder:
        return _made(ppl.evaluate(events, source, out=folder, **options))


def _made(evaluation: ppl.Evaluation) -> dict[str, Made]:
    """Return event id -> posterior, or prediction if the model keeps no posterior."""
    if evaluation.failures:
        event, why = next(iter(evaluation.failures.items()))
        raise ppl.errors.InvalidEventError(f"the model failed at the event {event}: {why}")
    given = evaluation.predictions.items()
    return {event: evaluation.posterior(event) or prediction for event, prediction in given}
