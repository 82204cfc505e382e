"""What the figures of a comparison of models are drawn from."""

from __future__ import annotations

import dataclasses
import functools
from collections.abc import Sequence

from phase_ppl.evaluation.comparison.comparison import ModelComparison
from phase_ppl.evaluation.figures.sheet import Results
from phase_ppl.evaluation.observers import (
    LABELS,
    PEOPLE,
    PEOPLE_COLOUR,
    Observer,
    colours_of,
    label_of,
    people,
)
from phase_ppl.world.event import Event


@dataclasses.dataclass(frozen=True)
class ComparedResults(Results):
    """The answers of all models of a comparison, and of people.

    Args:
        comparison: of the models.
    """

    comparison: ModelComparison

    @property
    def events(self) -> Sequence[Event]:
        return self.comparison.events

    @functools.cached_property
    def observers(self) -> list[Observer]:
        compared = self.comparison.contenders
        labels = [label_of(one.name) for one in compared]
        found = [Observer(PEOPLE, PEOPLE, LABELS[PEOPLE], PEOPLE_COLOUR, people(self.events))]
        for one, label, colour in zip(
            compared, labels, colours_of(self.comparison.models), strict=True
        ):
            unlike = label if labels.count(label) == 1 else one.name
            kind = "model" if one.kind == "model" else "reference"
            found.append(Observer(one.name, kind, unlike, colour, one.predictions))
        return [observer for observer in found if observer.predictions]

    @functools.cached_property
    def measured(self) -> list[Observer]:
        metrics = {**self.comparison.metrics, PEOPLE: self.comparison.people}
        return [dataclasses.replace(o, metrics=metrics[o.name]) for o in self.observers]
