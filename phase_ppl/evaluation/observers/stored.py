"""Models seen through an observer: answers as people are expected to give them."""

from __future__ import annotations

import dataclasses
import hashlib
import json
import os
from importlib import resources
from typing import Any, Final

from phase_ppl.evaluation.observers.answers import Made, evidence_of
from phase_ppl.evaluation.observers.fit import FittedObserver
from phase_ppl.evaluation.prediction import Prediction, as_prediction
from phase_ppl.evaluation.registry import Answer, Predict, ReadyModel
from phase_ppl.world.errors import InvalidSettingError, shown
from phase_ppl.world.event import Event
from phase_ppl.world.observation import Observation
from phase_ppl.world.scene import Scene

PEOPLE: Final = "people"
"""Name of the observers that come with the package, fitted to people's judgments of relations in
50 of PHASE's test videos; parameters only, no judgments."""

_FILE: Final = resources.files("phase_ppl.evaluation.observers") / "people.json"


def observer_of(given: str | os.PathLike[str] | FittedObserver, model: str) -> FittedObserver:
    """Return a fitted observer: itself, a file's, or "people", the package's for this model."""
    if isinstance(given, FittedObserver):
        return given
    if given != PEOPLE:
        return FittedObserver.load(given)
    known = json.loads(_FILE.read_text(encoding="utf-8"))
    if model not in known:
        raise InvalidSettingError(
            f"observer 'people' comes for the models {', '.join(known)}, not for {shown(model)}: "
            "phase_ppl.fit_people makes one"
        )
    return FittedObserver.from_dict(known[model])


@dataclasses.dataclass(frozen=True, eq=False)
class Observed:
    """A model whose answers an observer gives; what it was not fitted to stays the model's."""

    model: Predict
    observer: FittedObserver

    def __call__(self, scene: Scene, observation: Observation, seed: int) -> Answer:
        """Return the answers that people are expected to give."""
        perception = self.observer.perception
        readings = [observation]
        if perception is not None:
            readings = perception.readings(scene, observation, seed)
        answers = [self._asked(scene, one, seed) for one in readings]
        made: list[Made] = [answer.posterior or as_prediction(answer.given) for answer in answers]
        event = Event(scene, observation)
        evidence = evidence_of([event], {event.id: made})
        (expected,) = self.observer.predict(evidence).values()
        own = as_prediction(answers[0].given)
        given = {q: p for q, p in expected.probabilities.items() if q in self.observer.questions}
        kept = {q: a for q, a in own.answers.items() if q not in given}
        prediction = Prediction(
            "",
            {**{q: own.probabilities[q] for q in kept if q in own.probabilities}, **given},
            kept,
            own.cost,
            {q: e for q, e in own.errors.items() if q in kept},
        )
        return Answer(prediction, answers[0].artefacts)

    def _asked(self, scene: Scene, observation: Observation, seed: int) -> Answer:
        given = self.model(scene, observation, seed)
        return given if isinstance(given, Answer) else Answer(given)

    def warm_up(self) -> None:
        """Prepare what all processes share."""
        getattr(self.model, "warm_up", lambda: None)()


def observed(model: ReadyModel, given: str | os.PathLike[str] | FittedObserver) -> ReadyModel:
    """Return a model seen through an observer."""
    observer = observer_of(given, model.name)
    digest = hashlib.sha256(json.dumps(observer.to_dict()).encode()).hexdigest()
    record: dict[str, Any] = {**model.record, "observer": observer.name, "observer_digest": digest}
    return dataclasses.replace(model, predict=Observed(model.predict, observer), record=record)
