"""Observers: models of a person who watches. They turn evidence about a video into answers.

An observer is a NumPyro program: any callable ``observer(evidence)``, with :class:`Evidence`. It
samples its own parameters by ``numpyro.sample`` and returns question -> (event, answer) log
probabilities of people's answers. So::

    def timid(evidence):
        weight = numpyro.sample("weight", dist.LogNormal(0.0, 1.0))
        fear = numpyro.sample("fear", dist.Normal(0.0, 1.0))
        belief = weight * evidence.log_likelihood[0].mean(0) + evidence.log_prior
        belief += fear * tilt(evidence, evidence.cues["contact"], adversarial=1)
        return {"relation": log_shares(belief, evidence, "relation")}

:class:`Observer` builds one of ready-made parts, such as :func:`weight` or :func:`lapse`. Each part
changes a :class:`Belief` and samples the parameters that it names.
"""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Callable, Mapping
from typing import Any, Final, NamedTuple, TypeAlias

import jax
import jax.numpy as jnp
import numpy as np
import numpyro
import numpyro.distributions as dist
from jax import Array
from numpy.typing import ArrayLike, NDArray

import phase_ppl as ppl

__all__ = [
    "ANSWERS",
    "HALF_LIVES",
    "OBSERVERS",
    "Belief",
    "Evidence",
    "Observer",
    "cues",
    "inverse_temperature",
    "lapse",
    "leak",
    "log_shares",
    "observer_named",
    "prior",
    "respond",
    "samples",
    "saturation",
    "tilt",
    "weight",
]


FloatArray: TypeAlias = NDArray[np.float64]
IntArray: TypeAlias = NDArray[np.int64]

QUESTIONS: Final = ppl.questions_of(ppl.worlds.PHASE)
RELATIONS: Final = QUESTIONS["relation"]
"""Question about an event of PHASE -> possible answers; then the answers about the relation."""

HALF_LIVES: Final = (math.inf, 40.0, 10.0)
"""Frames after which evidence counts half, for each entry of :attr:`Evidence.log_likelihood`."""

_LEAST: Final = 1e-30  # keeps logarithms of shares finite in single precision

ANSWERS: Final = {name: len(QUESTIONS[name]) for name in ("relation", "goal_red", "goal_green")}
"""Question -> number of its answers."""


@dataclasses.dataclass(frozen=True, eq=False)
class Evidence:
    """The evidence that observers have about some videos.

    A hypothesis is a pair of effective goals where the model gave posteriors, else a relation.

    Attributes:
        events: ids of the videos.
        log_likelihood: (half-life, percept, event, hypothesis) log p(video | hypothesis), in the
            model's nats, up to a constant per event. Half-lives are :data:`HALF_LIVES`. Percepts
            are readings of the video; without noise there is one.
        log_prior: (event, hypothesis) log prior masses.
        answers: question -> (hypothesis,) index of the answer that the hypothesis implies.
        cues: name of a surface cue (``ppl.cues``) -> (event,) its value.
    """

    events: tuple[str, ...]
    log_likelihood: FloatArray
    log_prior: FloatArray
    answers: Mapping[str, IntArray]
    cues: Mapping[str, FloatArray]

    def at(self, places: ArrayLike) -> Evidence:
        """Return the evidence on the events whose indices are ``places``."""
        which = np.asarray(places, np.int64)
        return Evidence(
            tuple(self.events[i] for i in which),
            self.log_likelihood[:, :, which],
            self.log_prior[which],
            self.answers,
            {name: values[which] for name, values in self.cues.items()},
        )

    @property
    def numbers(self) -> tuple[Any, Any, dict[str, Any]]:
        """``log_likelihood``, ``log_prior`` and ``cues``, to be passed to a compiled program."""
        return self.log_likelihood, self.log_prior, dict(self.cues)

    def of_numbers(self, logs: Any, prior: Any, cues: Any) -> Evidence:
        """Return a copy with other :attr:`numbers`."""
        return dataclasses.replace(self, log_likelihood=logs, log_prior=prior, cues=cues)

    def condensed(self, single: int = 8, groups: int = 16) -> Evidence:
        """Return evidence on relations alone, with few hypotheses of each relation.

        For each relation and event the ``single`` most probable hypotheses stay. The rest form
        ``groups`` groups of equal size and similar likelihood; a group has the sum of its
        hypotheses' priors and the mean of their likelihoods. A fit then takes a twentieth of the
        time.
        """
        relations = self.answers["relation"]
        if relations.size <= len(RELATIONS) * (single + groups):
            return self
        likelihoods, priors = [], []
        for relation in range(len(RELATIONS)):
            of = np.flatnonzero(relations == relation)
            joint = self.log_likelihood[0].mean(axis=0)[:, of] + self.log_prior[:, of]
            order = of[np.argsort(-joint, axis=1)]  # event, hypothesis
            parts = [order[:, i : i + 1] for i in range(single)]
            for part in (*parts, *np.array_split(order[:, single:], groups, axis=1)):
                prior = np.take_along_axis(self.log_prior, part, axis=1)
                logs = np.take_along_axis(self.log_likelihood, part[None, None], axis=-1)
                mass = np.logaddexp.reduce(prior, axis=-1)
                priors.append(mass)
                likelihoods.append(np.logaddexp.reduce(logs + prior, axis=-1) - mass)
        codes = np.repeat(np.arange(len(RELATIONS)), single + groups)
        return dataclasses.replace(
            self,
            log_likelihood=np.stack(likelihoods, axis=-1),
            log_prior=np.stack(priors, axis=-1),
            answers={"relation": codes},
        )


class Belief(NamedTuple):
    """An observer's belief, and how it answers.

    Attributes:
        likelihood: (percept, event, hypothesis) log likelihood, unnormalised.
        prior: (event, hypothesis) log prior mass, unnormalised.
        inverse_temperature: exponent of the probabilities of answers.
        samples: number of hypotheses drawn from the belief before answering; each answer counts
            once more than it was drawn. Infinitely many give the belief itself.
        lapse: probability of an answer at random.
    """

    likelihood: Array
    prior: Array
    inverse_temperature: Array | float = 1.0
    samples: Array | float = math.inf
    lapse: Array | float = 0.0


Responses: TypeAlias = dict[str, Array]  # question -> (event, answer) log probabilities
Program: TypeAlias = Callable[[Evidence], Responses]
Part: TypeAlias = Callable[[Belief, Evidence], Belief]


def log_shares(log_mass: Array, evidence: Evidence, question: str) -> Array:
    """Return (..., event, answer) log probabilities of the answers to a question.

    Args:
        log_mass: (..., event, hypothesis) log masses of the hypotheses, unnormalised.
        evidence: says which answer each hypothesis implies.
        question: "relation", "goal_red" or "goal_green".
    """
    stands_for = jax.nn.one_hot(evidence.answers[question], ANSWERS[question])
    return jnp.log(jax.nn.softmax(log_mass, axis=-1) @ stands_for + _LEAST)


def tilt(evidence: Evidence, values: Any, **toward: float) -> Array:
    """Return (event, hypothesis) nats to add to a belief, by the hypothesis' relation.

    Args:
        evidence: says which relation each hypothesis implies.
        values: (event,) values, such as those of a cue, or one number for all events.
        **toward: relation -> nats per unit of ``values``; a relation that is not named gets 0 nats.

    Raises:
        UnknownNameError: there is no such relation.
    """
    for relation in toward:
        ppl.errors.check_name("relation", relation, RELATIONS)
    nats = jnp.array([toward.get(relation, 0.0) for relation in RELATIONS])
    return jnp.asarray(values)[..., None] * nats[evidence.answers["relation"]]


# --- noise ----------------------------------------------------------------------------------------


@dataclasses.dataclass(frozen=True)
class Perception:
    """Several noisy readings of a video, over which an observer's answers are averaged.

    Attributes:
        noise: standard deviation of the noise on each x and y, in units.
        missed: probability that a frame is not seen; its poses are interpolated.
        percepts: number of readings.

    Raises:
        InvalidSettingError: ``noise`` is negative, ``missed`` is not in [0, 1), or ``percepts`` is
            no positive whole number.
    """

    noise: float = 0.1
    missed: float = 0.0
    percepts: int = 4

    def __post_init__(self) -> None:
        for name in ("noise", "missed"):
            ppl.errors.nonnegative_number(name, getattr(self, name))
        if self.missed >= 1:
            raise ppl.errors.InvalidSettingError(
                f"missed={self.missed!r}, expected a number in [0, 1)"
            )
        ppl.errors.whole_number("percepts", self.percepts)

    def readings(
        self, scene: ppl.Scene, observation: ppl.Observation, seed: int
    ) -> list[ppl.Observation]:
        """Return ``percepts`` noisy observations of a video.

        Args:
            scene: the scene; noise moves no body out of its arena.
            observation: the video; no body may be unseen in any frame.
            seed: a whole number >= 0. Equal seeds give equal readings.
        """
        rng = np.random.default_rng(seed)
        trajectory = observation.whole("an observer").trajectory
        return [self._reading(scene, trajectory, rng) for _ in range(self.percepts)]

    def _reading(
        self, scene: ppl.Scene, trajectory: FloatArray, rng: np.random.Generator
    ) -> ppl.Observation:
        seen = rng.random(len(trajectory)) >= self.missed
        seen[[0, -1]] = True
        low, high = np.reshape(scene.arena, (2, 2)).T
        flat = np.array(trajectory).reshape(len(trajectory), -1)
        when = np.arange(len(flat))
        filled = np.stack([np.interp(when, when[seen], column[seen]) for column in flat.T], axis=1)
        found = filled.reshape(trajectory.shape)
        noise = rng.normal(0.0, self.noise, found[1:, :, :2].shape) * seen[1:, None, None]
        found[1:, :, :2] = np.clip(found[1:, :, :2] + noise, low, high)
        return ppl.Observation(found)


# --- parts ----------------------------------------------------------------------------------------


def leak(belief: Belief, evidence: Evidence) -> Belief:
    """Let evidence fade: the parameter ``leak`` goes from 0 (never) to 2 (it halves in 10 frames).

    Between whole numbers it interpolates the evidence at the half-lives of :data:`HALF_LIVES`. It
    reads the original evidence, and so must be the first part of an observer.
    """
    most = len(HALF_LIVES) - 1
    place = numpyro.sample("leak", dist.Uniform(0, most))
    shares = jnp.maximum(0.0, 1 - jnp.abs(place - jnp.arange(most + 1)))
    return belief._replace(likelihood=jnp.tensordot(shares, evidence.log_likelihood, 1))


def weight(belief: Belief, evidence: Evidence) -> Belief:
    """Let evidence count ``weight`` times as much as for the model."""
    times = numpyro.sample("weight", dist.LogNormal(0.0, 1.0))
    return belief._replace(likelihood=times * belief.likelihood)


def saturation(belief: Belief, evidence: Evidence) -> Belief:
    """Let evidence saturate: no relation's is more than ``most_evidence`` nats below the best."""
    most = numpyro.sample("most_evidence", dist.LogNormal(math.log(3.0), 0.7))
    prior = log_shares(belief.prior, evidence, "relation")
    found = log_shares(belief.likelihood + belief.prior, evidence, "relation") - prior
    behind = found.max(axis=-1, keepdims=True) - found
    less = behind - most * -jnp.expm1(-behind / most)
    return belief._replace(
        likelihood=belief.likelihood + less[..., jnp.asarray(evidence.answers["relation"])]
    )


def prior(belief: Belief, evidence: Evidence) -> Belief:
    """Add people's own prior: ``prior_friendly`` and ``prior_neutral``, nats beyond the model's.

    "adversarial" gets 0.
    """
    friendly = numpyro.sample("prior_friendly", dist.Normal(0.0, 1.0))
    neutral = numpyro.sample("prior_neutral", dist.Normal(0.0, 1.0))
    own = tilt(evidence, friendly, friendly=1.0) + tilt(evidence, neutral, neutral=1.0)
    return belief._replace(prior=belief.prior + own)


def cues(**toward: str) -> Part:
    """Return a part in which cues are evidence of a relation, as ``cues(distance="neutral")``.

    A cue's likelihood is exponential in its value, with the parameter ``cue_<name>``, nats per
    unit. So with ``cues(contact="neutral")`` a negative ``cue_contact`` says that agents who want
    nothing of each other do not touch. The common scale of these parameters, ``cue_scale``, is
    inferred, so that useless cues shrink together.

    Args:
        **toward: name of a cue (``ppl.cues.CUES``) -> the relation that it is evidence of.

    Raises:
        UnknownNameError: there is no such cue or relation.
    """
    for name, relation in toward.items():
        ppl.errors.check_name("cue", name, ppl.cues.CUES)
        ppl.errors.check_name("relation", relation, RELATIONS)

    def part(belief: Belief, evidence: Evidence) -> Belief:
        scale = numpyro.sample("cue_scale", dist.HalfNormal(2.0))
        likelihood = belief.likelihood
        for name, relation in toward.items():
            raw = numpyro.sample(f"raw_{name}", dist.Normal(0.0, 1.0))
            nats = numpyro.deterministic(f"cue_{name}", scale * raw)
            likelihood += tilt(evidence, nats * evidence.cues[name], **{relation: 1.0})
        return belief._replace(likelihood=likelihood)

    part.__name__ = f"cues({', '.join(f'{name}={relation}' for name, relation in toward.items())})"
    return part


def inverse_temperature(belief: Belief, evidence: Evidence) -> Belief:
    """Raise the probabilities of answers to the power ``inverse_temperature``."""
    return belief._replace(
        inverse_temperature=numpyro.sample("inverse_temperature", dist.LogNormal(0.0, 0.5))
    )


def samples(belief: Belief, evidence: Evidence) -> Belief:
    """Let answers follow a few hypotheses drawn from the belief, ``samples`` of them."""
    return belief._replace(samples=numpyro.sample("samples", dist.LogNormal(math.log(10), 1.0)))


def lapse(belief: Belief, evidence: Evidence) -> Belief:
    """Let an answer be random with probability ``lapse``."""
    return belief._replace(lapse=numpyro.sample("lapse", dist.Beta(1.0, 20.0)))


# --- observers ------------------------------------------------------------------------------------


def respond(belief: Belief, evidence: Evidence) -> Responses:
    """Return question -> (event, answer) log probabilities of the answers that a belief gives."""
    log_mass = belief.likelihood + belief.prior
    found = {}
    for question in evidence.answers:
        logs = log_shares(log_mass, evidence, question)
        of_one = jax.nn.softmax(belief.inverse_temperature * logs, axis=-1)
        shares, n = of_one.mean(axis=0), ANSWERS[question]
        shares = (shares + 1 / belief.samples) / (1 + n / belief.samples)
        found[question] = jnp.log((1 - belief.lapse) * shares + belief.lapse / n + _LEAST)
    return found


@dataclasses.dataclass(frozen=True, init=False)
class Observer:
    """An observer made of parts, which are applied in order.

    ``Observer(weight, prior, cues(distance="neutral"), lapse)``. Without parts it answers as the
    model does. A part is a function ``(belief, evidence) -> belief`` that may sample parameters.

    Raises:
        InvalidSettingError: a part is no function, or ``leak`` is not the first part.
    """

    parts: tuple[Part, ...]

    def __init__(self, *parts: Part) -> None:
        for part in parts:
            if not callable(part):
                raise ppl.errors.InvalidSettingError(
                    f"part {ppl.errors.shown(part)} is no function (belief, evidence)"
                )
        if leak in parts[1:]:
            raise ppl.errors.InvalidSettingError(
                "leak must be the first part: it reads all evidence anew, undoing earlier parts"
            )
        object.__setattr__(self, "parts", parts)

    def __call__(self, evidence: Evidence) -> Responses:
        """Sample parameters; return question -> (event, answer) log probabilities of answers."""
        belief = Belief(jnp.asarray(evidence.log_likelihood[0]), jnp.asarray(evidence.log_prior))
        for part in self.parts:
            belief = part(belief, evidence)
        return respond(belief, evidence)

    def __repr__(self) -> str:
        return f"Observer({', '.join(part.__name__ for part in self.parts)})"


_RESPONSE: Final = (weight, saturation, prior)

OBSERVERS: Final[Mapping[str, Observer]] = {
    "model": Observer(),
    "lapsing": Observer(weight, prior, lapse),
    "saturating": Observer(*_RESPONSE, lapse),
    "leaky": Observer(leak, *_RESPONSE, lapse),
    "sampling": Observer(*_RESPONSE, samples),
    "contact": Observer(*_RESPONSE, cues(contact="neutral"), lapse),
    "distance": Observer(*_RESPONSE, cues(distance="neutral"), lapse),
    "company": Observer(*_RESPONSE, cues(distance="neutral", contact="neutral"), lapse),
    "attentive": Observer(
        *_RESPONSE,
        cues(distance="neutral", contact="neutral", working="friendly", impact="adversarial"),
        lapse,
    ),
    "vigilant": Observer(
        *_RESPONSE,
        cues(
            distance="neutral", contact="neutral", synchrony="neutral", working="friendly",
            holding="friendly", impact="adversarial", unsettled="adversarial",
        ),
        lapse,
    ),
}  # fmt: skip
"""Name -> ready-made observer."""


def observer_named(name: str) -> Observer:
    """Return the observer of :data:`OBSERVERS` with that name.

    Raises:
        UnknownNameError: there is no such observer.
    """
    ppl.errors.check_name("observer", name, OBSERVERS)
    return OBSERVERS[name]


def __dir__() -> list[str]:
    return __all__
