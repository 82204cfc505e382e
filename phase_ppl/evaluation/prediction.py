"""Answers to the questions about an event, by a model, a file of predictions, or people."""

from __future__ import annotations

import dataclasses
import functools
import math
import numbers
from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any, Final

import numpy as np
from numpy.typing import ArrayLike, NDArray

from phase_ppl.analysis.estimate import Estimate
from phase_ppl.data.documents import in_front, of_kind
from phase_ppl.world.arrays import FloatArray
from phase_ppl.world.errors import (
    InvalidEventError,
    check_name,
    instance_of,
    nonnegative_number,
    shown,
    unknown_name,
)
from phase_ppl.world.event import Event, frame_shown
from phase_ppl.world.hypothesis import RELATIONS, scenario
from phase_ppl.world.names import AGENTS
from phase_ppl.world.picture import plain
from phase_ppl.world.scene import PHASE, World
from phase_ppl.world.space import space_of

if TYPE_CHECKING:
    from phase_ppl.analysis.event_posterior import EventPosterior

_SUM_TOLERANCE: Final = 1e-3
_COUNTED: Final = ("simulations", "frames", "frames_saved", "failures", "retries", "searches")


@functools.lru_cache(16)
def questions_of(world: World) -> Mapping[str, tuple[str, ...]]:
    """Return question -> its possible answers, in label order, for a world.

    Questions are named like a posterior's quantities: ``goal_<agent>`` and
    ``relation_<one>_<other>``, with the agents' ``world.keys``. PHASE has one pair, whose question
    is ``relation``. Goals are effective goals.
    """
    goals = {f"goal_{key}": world.goals for key in world.keys}
    return goals | dict.fromkeys(pairs_of(world), RELATIONS)


@functools.lru_cache(16)
def pairs_of(world: World) -> Mapping[str, tuple[str, str]]:
    """Return question about a relation -> the names of its two agents, for a world."""
    found = {
        name: (world.agents[one], world.agents[other])
        for name, (one, other) in space_of(world).relation_names.items()
    }
    return dict(sorted(found.items(), key=lambda pair: world.agents.index(pair[1][1])))


def independent(goals: NDArray[Any], world: World) -> dict[str, NDArray[Any]]:
    """Return question -> probabilities, from (agent, goal) ones of independent agents."""
    found = {f"goal_{key}": shares for key, shares in zip(world.keys, goals, strict=True)}
    for question, pair in pairs_of(world).items():
        one, other = map(world.agent, pair)
        codes = space_of(world).relations[one, other].ravel()
        joint = np.outer(goals[one], goals[other]).ravel()
        found[question] = np.bincount(codes, joint, len(RELATIONS))
    return found


QUESTIONS: Final = questions_of(PHASE)
"""What is asked about an event of PHASE -> the possible answers, in label order."""

GOAL_QUESTIONS: Final = dict(zip(AGENTS, QUESTIONS, strict=False))
"""Agent of PHASE -> the question about its goal."""


@dataclasses.dataclass(frozen=True, eq=False)
class Prediction:
    """Answers to the questions about one event. What is not given is absent, never guessed.

    Probabilities and errors are arrays (label,), in the order of :func:`questions_of`.

    Attributes:
        event_id: id of the event.
        probabilities: question -> (label,) probabilities of its answers, sum 1.
        errors: question -> (label,) Monte-Carlo errors of the probabilities; NaN: unknown. Only
            questions with probabilities can have errors.
        answers: question -> the answer given. If only probabilities are given, it is the most
            probable answer, of equals the first in label order.
        cost: what the model counts, such as seconds and simulations.
        world: world of the event; it has the questions and their answers.
        sure: question -> whether the answer is sure, by the posterior's ``leaders()``; empty: the
            model has no posterior.
        decided: whether the posterior is sure of the event as a whole, by its ``diagnostics()``;
            None: the model has no posterior.
        moments: seconds of the film -> question -> (label,) probabilities given the film until
            then; for the moments at which people judged.
        hindsight: says in words that ``moments`` are in hindsight
            (:meth:`phase_ppl.Posterior.over_time`); "": they are not.

    Raises:
        UnknownNameError: there is no such question or answer; the message names close matches.
        InvalidSettingError: ``sure`` or ``decided`` is neither true nor false.
        InvalidEventError: probabilities are not one per answer, are negative or not finite, or do
            not sum to 1 within 0.001 (they are then normalised exactly); or errors are not one
            number >= 0 or NaN per probability.
    """

    event_id: str
    probabilities: Mapping[str, FloatArray] = dataclasses.field(default_factory=dict)
    answers: Mapping[str, str] = dataclasses.field(default_factory=dict)
    cost: Mapping[str, Any] = dataclasses.field(default_factory=dict)
    errors: Mapping[str, FloatArray] = dataclasses.field(default_factory=dict)
    world: World = PHASE
    sure: Mapping[str, bool] = dataclasses.field(default_factory=dict)
    decided: bool | None = None
    moments: Mapping[float, Mapping[str, FloatArray]] = dataclasses.field(default_factory=dict)
    hindsight: str = ""

    def __post_init__(self) -> None:
        for question in {**self.probabilities, **self.answers, **self.errors, **self.sure}:
            labels_of(question, self.world)
        for name, verdict in {**self.sure, **self._of_event}.items():
            instance_of(name, verdict, bool, "True or False")
        probabilities, answers = {}, {}
        for question, labels in self.questions.items():
            if question in self.probabilities:
                values = _distribution(question, self.probabilities[question], labels)
                probabilities[question] = values
                answers[question] = labels[int(values.argmax())]
            if question in self.answers:
                answers[question] = checked_answer(question, self.answers[question], self.world)
        errors = {question: np.array(given, np.float64) for question, given in self.errors.items()}
        for question, found in errors.items():
            if question not in probabilities:
                raise InvalidEventError(f"{question} has errors, but no probabilities")
            if found.shape != probabilities[question].shape or (found < 0).any():
                raise InvalidEventError(
                    f"{question} has errors {shown(self.errors[question])}, expected "
                    f"{len(probabilities[question])} numbers >= 0 or NaN"
                )
        moments = {
            float(at): {
                question: _distribution(question, values, labels_of(question, self.world))
                for question, values in given.items()
            }
            for at, given in sorted(self.moments.items())
        }
        for name, checked in (
            ("errors", errors), ("probabilities", probabilities), ("answers", answers),
            ("moments", moments),
        ):  # fmt: skip
            object.__setattr__(self, name, checked)

    @classmethod
    def of(cls, given: object, event_id: str = "", world: World = PHASE) -> Prediction:
        """Return what a model answered as a prediction.

        Args:
            given: a prediction; the posterior of an event; or question -> a label, label ->
                probability, or probabilities in label order; None instead of these is no answer.
            event_id: id of the event.
            world: world of the event.

        Raises:
            InvalidEventError, UnknownNameError: ``given`` is none of these, is empty, or is about
                another world; or it makes no valid :class:`Prediction`.
        """
        from phase_ppl.analysis.event_posterior import EventPosterior

        if isinstance(given, cls | EventPosterior) and given.world != world:
            raise InvalidEventError(
                f"the answer is about an event of the world {given.world.name!r}, not "
                f"{world.name!r}"
            )
        if isinstance(given, cls):
            found = dataclasses.replace(given, event_id=event_id)
        elif isinstance(given, EventPosterior):
            marginals = {question: given.marginal(question) for question in questions_of(world)}
            leaders = given.leaders()
            found = cls(
                event_id,
                probabilities={question: one.values for question, one in marginals.items()},
                cost={name: given.cost[name] for name in _COUNTED if name in given.cost},
                errors={question: one["error"].values for question, one in marginals.items()},
                world=world,
                sure={question: leaders[question]["sure"] for question in marginals},
                decided=bool(given.diagnostics()["decided"]),
            )
        elif isinstance(given, Mapping):
            answered = {q: answer for q, answer in given.items() if answer is not None}
            labels = {q: answer for q, answer in answered.items() if isinstance(answer, str)}
            probabilities = {
                q: probabilities_of(q, shares, world) if isinstance(shares, Mapping) else shares
                for q, shares in answered.items()
                if q not in labels
            }
            found = cls(event_id, probabilities, labels, world=world)
        else:
            raise InvalidEventError(
                f"the answer is {shown(given)}, expected a Prediction, a posterior or a "
                f"mapping with {_one_of(world)}"
            )
        if not found.answers:
            raise InvalidEventError(f"the answer is empty: {_one_of(world)} is needed")
        return found

    def at(self, moment: float) -> Prediction:
        """Return the prediction given the film until a moment; without answers if there is none.

        ``moment`` is in seconds of the film, a key of :attr:`moments`.
        """
        return Prediction(self.event_id, self.moments.get(moment, {}), world=self.world)

    @property
    def _of_event(self) -> dict[str, bool]:
        """What is known of the event as a whole, by name."""
        return {} if self.decided is None else {"decided": self.decided}

    @property
    def questions(self) -> Mapping[str, tuple[str, ...]]:
        """Question -> its possible answers in label order, for the event's world."""
        return questions_of(self.world)

    @property
    def scenario(self) -> str | None:
        """Scenario of the two goals answered; None: a goal is missing, or the world is no PHASE."""
        answered = self.answers.keys() >= {*GOAL_QUESTIONS.values()}
        if not (space_of(self.world).scenario_names and answered):
            return None
        red, green = (self.answers[question] for question in GOAL_QUESTIONS.values())
        return scenario(red, green)

    def estimate(self, question: str, answer: str) -> Estimate:
        """Return the probability of an answer to a question, with its error (NaN: unknown)."""
        place = self.questions[question].index(answer)
        errors = self.errors.get(question)
        error = math.nan if errors is None else float(errors[place])
        return Estimate(float(self.probabilities[question][place]), error)

    def to_dict(self) -> dict[str, Any]:
        """Return the prediction as plain data, fit for JSON; :meth:`from_dict` gives it back.

        Answers of probability 0 are left out.
        """
        labels = self.questions
        probabilities = {q: _possible(labels[q], p) for q, p in self.probabilities.items()}
        errors = {
            q: dict(zip(labels[q], plain(values), strict=True)) for q, values in self.errors.items()
        }
        moments = [
            {"at": at, **{q: _possible(labels[q], values) for q, values in given.items()}}
            for at, given in self.moments.items()
        ]
        return {
            "event": self.event_id,
            "probabilities": probabilities,
            **({"errors": errors} if errors else {}),
            "answers": dict(self.answers),
            "cost": dict(self.cost),
            **({"sure": dict(self.sure)} if self.sure else {}),
            **self._of_event,
            **({"moments": moments, "hindsight": self.hindsight} if moments else {}),
        }

    @classmethod
    def from_dict(cls, record: Mapping[str, Any], world: World = PHASE) -> Prediction:
        """Read what :meth:`to_dict` wrote about an event of ``world``; answers left out get 0.

        Raises:
            InvalidEventError, UnknownNameError: a field is missing or of another type, or
                ``record`` makes no valid :class:`Prediction`.
        """
        given = {**record, **{name: record.get(name) or {} for name in ("cost", "errors", "sure")}}
        of_kind("event of a prediction", given.get("event"), str)
        for name in ("probabilities", "errors", "answers", "cost", "sure"):
            of_kind(f"{name} of a prediction", given.get(name), dict)
        listed = of_kind("moments of a prediction", given.get("moments") or [], list)
        moments = [dict(of_kind("a moment of a prediction", one, dict)) for one in listed]
        return cls(
            event_id=record["event"],
            probabilities={
                question: probabilities_of(question, shares, world)
                for question, shares in record["probabilities"].items()
            },
            answers=record["answers"],
            cost=given["cost"],
            errors={
                question: probabilities_of(question, errors, world, math.nan)
                for question, errors in given["errors"].items()
            },
            world=world,
            sure=given["sure"],
            decided=given.get("decided"),
            moments={
                nonnegative_number("at", one.pop("at", None)): {
                    question: probabilities_of(question, shares, world)
                    for question, shares in one.items()
                }
                for one in moments
            },
            hindsight=of_kind("hindsight of a prediction", given.get("hindsight") or "", str),
        )

    def __repr__(self) -> str:
        return f"<Prediction of {self.event_id}: {', '.join(self.answers.values())}>"


def until_moments(
    post: EventPosterior, moments: Sequence[float]
) -> tuple[dict[float, dict[str, FloatArray]], str]:
    """Return seconds of the film -> question -> probabilities, and :attr:`Prediction.hindsight`.

    Each is of the frame then shown. Before 0.25 s that is the first; a model that is asked of the
    film until then sees two, as every observation has.
    """
    found = post.over_time()
    last, hindsight = found.sizes["time"] - 1, found.attrs.get("hindsight", "")
    tables = {
        question: found[question].sel({f"{question}_is": list(labels)}).values
        for question, labels in questions_of(post.world).items()
    }
    of_moments = {
        at: {question: table[min(frame_shown(at), last)] for question, table in tables.items()}
        for at in moments
    }
    return of_moments, str(hindsight)


def _one_of(world: World) -> str:
    *others, last = questions_of(world)
    return f"{', '.join(others)} or {last}" if others else last


def _possible(labels: Sequence[str], values: FloatArray) -> dict[str, float]:
    """Return answer -> probability, of those that have any."""
    return {one: float(p) for one, p in zip(labels, values, strict=True) if p > 0}


def probabilities_of(
    question: str, shares: Mapping[str, Any], world: World = PHASE, default: float = 0.0
) -> FloatArray:
    """Return probabilities in label order from answer -> probability; those left out are 0.

    Or their errors, with the ``default`` NaN for those that are left out, or null.
    """
    labels = labels_of(question, world)
    if not isinstance(shares, Mapping):
        raise InvalidEventError(f"{question} is {shown(shares)}, expected answers with numbers")
    values = np.full(len(labels), default)
    for answer, share in shares.items():
        if share is None and math.isnan(default):
            continue
        if isinstance(share, bool) or not isinstance(share, numbers.Real):
            raise InvalidEventError(f"{question}: {answer!r} has {shown(share)}, expected a number")
        values[labels.index(checked_answer(question, answer, world))] = share
    return values


def labels_of(question: str, world: World = PHASE) -> tuple[str, ...]:
    """Return the possible answers to a question (UnknownNameError: there is no such question)."""
    questions = questions_of(world)
    check_name("question", question, questions)
    return questions[question]


def checked_answer(question: str, answer: object, world: World = PHASE) -> str:
    """Return ``answer`` as the labels of ``question`` spell it; case and spaces do not matter."""
    if labels_of(question, world) is not RELATIONS:
        return world.goals[world.goal_index(str(answer))]
    relation = str(answer).strip().lower()
    if relation not in RELATIONS:
        raise unknown_name("relation", answer, RELATIONS)
    return relation


def _distribution(question: str, given: ArrayLike, labels: Sequence[str]) -> FloatArray:
    try:
        values = np.array(given, np.float64)
    except (TypeError, ValueError):
        raise InvalidEventError(f"{question} is {shown(given)}, expected numbers") from None
    if values.shape != (len(labels),):
        raise InvalidEventError(
            f"{question} has probabilities of shape {values.shape}, expected ({len(labels)},)"
        )
    if not np.isfinite(values).all() or (values < 0).any():
        bad = values[~np.isfinite(values) | (values < 0)][0]
        raise InvalidEventError(f"{question} has the probability {bad}, expected 0 to 1")
    total = values.sum()
    if abs(total - 1) > _SUM_TOLERANCE:
        raise InvalidEventError(f"{question} has probabilities of sum {total:.4g}, expected 1")
    if abs(total - 1) > len(values) * np.finfo(np.float64).eps:
        values /= total  # not again, so that what was written is read as it was
    values.flags.writeable = False
    return values


# --- of other models, as files of events carry them -----------------------------------------------

_FIELDS: Final = (
    *("probabilities", "errors", "answers", "cost", "sure", "decided", "event"),
    *("moments", "hindsight"),
)
_SHORT: Final = ("goals", "relation", "goal_probs", "relation_probs")


def reference_predictions(events: Sequence[Event]) -> dict[str, dict[str, Prediction]]:
    """Return model -> event id -> the prediction that the event carries; other events are left out.

    Models come in the order in which the events name them first. ``event.predictions`` maps the
    name of a model to a prediction in one of two forms. One is what :meth:`Prediction.to_dict`
    writes, where ``event`` may be missing. The other is below; every field may be missing or null::

        {"goals": {"red agent": "...", "green agent": "..."}, "relation": "friendly",
         "goal_probs": {"red agent": {"...": 0.9, "...": 0.1}, ...},
         "relation_probs": {"friendly": 0.6, "neutral": 0.3, "adversarial": 0.1}}

    Goals are effective goals. Answers of probability 0 may be left out.

    Raises:
        InvalidEventError: a prediction has neither form, or its probabilities are invalid.
        UnknownNameError: a field, agent, goal or relation is unknown. Messages begin with the event
            and the model.
    """
    found: dict[str, dict[str, Prediction]] = {}
    for event in events:
        for model, record in (event.predictions or {}).items():
            if record is None:
                continue
            with in_front(f"event {event.id}: predictions: {model}: "):
                prediction = _prediction(event.id, record, event.scene.world)
            found.setdefault(str(model), {})[event.id] = prediction
    return found


def _prediction(event_id: str, record: object, world: World) -> Prediction:
    fields = of_kind("it", record, dict)
    given = {name: value for name, value in fields.items() if value is not None}
    own = "probabilities" in given or "answers" in given
    for name in given:
        check_name("field", name, _FIELDS if own else (*_SHORT, *_FIELDS))
    if given.get("event", event_id) != event_id:
        raise InvalidEventError(
            f"names the event {shown(given['event'])}, expected {shown(event_id)}"
        )
    if not own:
        answers, shares = (per_agent(f, given.pop(f, None), world) for f in ("goals", "goal_probs"))
        if "relation" in given:
            answers["relation"] = given.pop("relation")
        if "relation_probs" in given:
            shares["relation"] = given.pop("relation_probs")
        given |= {"answers": answers, "probabilities": shares}
    return Prediction.from_dict(
        {"answers": {}, "probabilities": {}, **given, "event": event_id}, world
    )


def per_agent(field: str, record: object, world: World) -> dict[str, Any]:
    """Return question -> value from agent -> value, without those that are null."""
    values = {} if record is None else of_kind(field, record, dict)
    for agent in values:
        check_name(f"agent in {field}", agent, world.agents)
    keys = dict(zip(world.agents, world.keys, strict=True))
    return {f"goal_{keys[agent]}": v for agent, v in values.items() if v is not None}
