"""Who is compared: evaluations, models whose answers the events carry, on the same events."""

from __future__ import annotations

import dataclasses
import os
from collections.abc import Collection, Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any, Final, TypeAlias

from phase_ppl.evaluation.answer_sets import PEOPLE
from phase_ppl.evaluation.evaluation import Evaluation
from phase_ppl.evaluation.folder import SETTINGS
from phase_ppl.evaluation.prediction import Prediction, reference_predictions
from phase_ppl.world.errors import InvalidEventError, InvalidSettingError, shown, unknown_name
from phase_ppl.world.event import Event
from phase_ppl.world.identity import event_digest

Source: TypeAlias = Evaluation | str | os.PathLike[str]
ALL: Final = "all"  # stands for all models whose answers the events carry


@dataclasses.dataclass(frozen=True, eq=False)
class Entry:
    """A model that is compared."""

    name: str  # as the comparison calls it, different for all
    kind: str  # "model", of an evaluation; or "stored", whose answers the events carry
    predictions: Mapping[str, Prediction]  # event id -> answers, of the events compared
    # of the evaluation, as in its settings.json but for the events
    settings: Mapping[str, Any] = dataclasses.field(default_factory=dict)
    # event id -> what went wrong, of the events compared
    failures: Mapping[str, str] = dataclasses.field(default_factory=dict)
    folder: str | None = None  # of the evaluation, if it has one


def evaluations(sources: Source | Sequence[Source] | Mapping[str, Source]) -> dict[str, Evaluation]:
    """Return name -> evaluation.

    A folder that holds no evaluation itself stands for those in it, under the names of their
    folders. Others go by the name of the model or, where several are of the same, of the folder.
    """
    if isinstance(sources, Mapping):
        check_names(list(sources))
        return {name: _evaluation(source) for name, source in sources.items()}
    if isinstance(sources, str | os.PathLike | Evaluation):
        sources = [sources]
    found: list[tuple[str | None, Evaluation]] = []
    for source in sources:
        inside = [] if isinstance(source, Evaluation) else _inside(source)
        if inside:
            found += [(folder.name, Evaluation.load(folder)) for folder in inside]
        else:
            found.append((None, _evaluation(source)))
    models = [evaluation.name for _, evaluation in found]
    named: dict[str, Evaluation] = {}
    for given, evaluation in found:
        name = given or evaluation.name
        folder = evaluation.folder
        if given is None and models.count(name) > 1 and folder is not None:
            name = folder.path.resolve().name
        if name in named:
            raise InvalidSettingError(
                f"two of the evaluations would be called {name!r}: name them, as in "
                f"{{'one': ..., 'other': ...}} or one=DIR other=DIR"
            )
        named[name] = evaluation
    return named


def check_names(names: Sequence[object]) -> None:
    """Raise InvalidSettingError unless all are names by which models can be told apart."""
    for place, name in enumerate(names):
        if not (isinstance(name, str) and name.strip()):
            raise InvalidSettingError(f"a model is called {shown(name)}, expected a name")
        if name == PEOPLE:
            raise InvalidSettingError(f"a model is called {name!r}, as people are: name it, as in "
                                      "{'mine': ...} or mine=DIR")  # fmt: skip
        if name in names[:place]:
            raise InvalidSettingError(f"two models are called {name!r}: expected different names")


def _inside(source: object) -> list[Path]:
    """Return the folders of evaluations in a folder that is none itself."""
    if not isinstance(source, str | os.PathLike) or (Path(source) / SETTINGS).is_file():
        return []
    return sorted(file.parent for file in Path(source).glob(f"*/{SETTINGS}"))


def _evaluation(source: object) -> Evaluation:
    if isinstance(source, Evaluation):
        return source
    if not isinstance(source, str | os.PathLike):
        raise InvalidSettingError(f"{shown(source)} is neither an evaluation nor the folder of one")
    if not Path(source).exists():
        raise InvalidEventError(f"{source}: no such folder")
    return Evaluation.load(source)


def shared_events(
    found: Mapping[str, Evaluation], common: bool = False
) -> tuple[list[Event], list[str]]:
    """Return the events that all evaluations are about, and notes about them.

    Events are the same if they have the same id and all that is seen of them is the same. Truth
    and judgments are those of the first evaluation.
    """
    (first, evaluation), *others = found.items()
    notes = []
    chosen = {event.id: event for event in evaluation.events}
    digests = {event.id: event_digest(event) for event in evaluation.events}
    for name, other in others:
        theirs = {event.id: event for event in other.events}
        same = {i for i in digests if i in theirs and event_digest(theirs[i]) == digests[i]}
        if not common and not len(same) == len(digests) == len(theirs):
            raise InvalidEventError(
                f"{first} and {name} were asked about different events: "
                f"{_differences(first, digests, name, theirs, same)}; common=True (--common) "
                "compares them on the events that all share"
            )
        chosen = {i: event for i, event in chosen.items() if i in same}
        changed = [
            i
            for i, e in chosen.items()
            if (e.truth, e.judgments) != (theirs[i].truth, theirs[i].judgments)
        ]
        if changed:
            notes.append(
                f"truth or judgments of {len(changed)} events, such as {changed[0]!r}, are not the "
                f"same in {first} and {name}; those in {first} count"
            )
    if not chosen:
        raise InvalidEventError(f"there is no event that {', '.join(found)} share")
    largest = max(len(one.events) for one in found.values())
    if len(chosen) < largest:
        notes.insert(0, f"on the {len(chosen)} events that all share, of up to {largest}")
    return list(chosen.values()), notes


def _differences(
    first: str, mine: Iterable[str], name: str, theirs: Iterable[str], same: Collection[str]
) -> str:
    both = set(mine) & set(theirs)
    groups = {
        f"only in {first}": [i for i in mine if i not in both],
        f"only in {name}": [i for i in theirs if i not in both],
        "not the same in scene or observation": [i for i in mine if i in both and i not in same],
    }
    return ", ".join(
        f"{len(ids)} {what} (such as {ids[0]!r})" for what, ids in groups.items() if ids
    )


def entries(
    found: Mapping[str, Evaluation], events: Sequence[Event], stored: str | Sequence[str] = ()
) -> list[Entry]:
    """Return the models that are compared, with their answers about the events."""
    ids = [event.id for event in events]
    made = [
        Entry(
            name,
            "model",
            {i: one.predictions[i] for i in ids if i in one.predictions},
            {key: value for key, value in one.settings.items() if key != "events"},
            {i: str(one.failures[i]) for i in ids if i in one.failures},
            None if one.folder is None else str(one.folder.path),
        )
        for name, one in found.items()
    ]
    references = reference_predictions(events)
    for name in stored_names(stored, references):
        made.append(Entry(stored_label(name, found), "stored", references[name]))
    return made


def stored_label(name: str, models: Collection[str]) -> str:
    """Return how a model whose answers the events carry is called beside other models."""
    return f"{name} (stored)" if name in models or name == PEOPLE else name


def stored_names(stored: str | Sequence[str], references: Iterable[str]) -> list[str]:
    """Return the names of the models, whose answers the events carry, that are wanted."""
    known = list(references)
    if isinstance(stored, str):
        stored = known if stored == ALL else [stored]
    if not isinstance(stored, Iterable):
        raise InvalidSettingError(f"stored={shown(stored)}, expected names of models, or {ALL!r}")
    for name in stored:
        if name not in known:
            raise unknown_name("stored model", name, known)
    return list(dict.fromkeys(stored))
