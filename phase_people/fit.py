"""Observers fitted to people: parameters, predictions, and out-of-sample quality."""

from __future__ import annotations

import dataclasses
import functools
import hashlib
import json
import os
from collections.abc import Callable, Mapping, Sequence
from importlib import resources
from typing import Any, Final

import jax
import jax.numpy as jnp
import numpy as np
import xarray as xr
from jax import Array
from numpyro import handlers
from numpyro.infer import MCMC, NUTS

import phase_ppl as ppl
from phase_people.answers import Answers, check_is_phase, evidence_of, expected, people
from phase_people.observers import (
    OBSERVERS,
    Evidence,
    FloatArray,
    Perception,
    Program,
    observer_named,
)

SCHEMA: Final = "phase-ppl-observer-1"
KEPT: Final = 200  # draws of the parameters in a file; enough for a mean over them
UNRELIABLE: Final = 0.7  # Pareto k from which on leaving an event out needs a new fit
_NOT_PARAMETERS: Final = ("log_likelihood", "rater", "own_pace")
_AT_A_TIME: Final = 50

PEOPLE: Final = "people"
"""Name of the observers that come with the package. They were fitted to people's judgments of
relations in 50 of PHASE's test videos, and have parameters only, no judgments."""

_FILE: Final = resources.files("phase_people") / "people.json"
_REMEMBERED: Final = 4  # cached samplers, so that observers fitted in turn compile once each


@dataclasses.dataclass(frozen=True, eq=False)
class FittedObserver:
    """An observer with posterior draws of its parameters; it predicts people's answers.

    Attributes:
        observer: the observer's program: evidence -> question -> (event, answer) log probabilities.
        name: name of the ready-made observer (``ppl.observers.OBSERVERS``); "": another program.
        draws: name of a parameter -> (draw,) values.
        questions: the questions whose answers it was fitted to.
        perception: noise with which the observer sees videos; None: no noise.
    """

    observer: Program
    name: str
    draws: Mapping[str, FloatArray]
    questions: tuple[str, ...]
    perception: Perception | None

    @ppl.tracing()
    def shares(self, evidence: Evidence) -> dict[str, FloatArray]:
        """Return question -> (draw, event, answer) expected shares of people, given evidence."""

        def of_all(draws: dict[str, Array], numbers: Any) -> dict[str, Array]:
            def of_one(draw: dict[str, Array]) -> dict[str, Array]:
                program = handlers.substitute(self.observer, draw)
                with handlers.block(), handlers.seed(rng_seed=0), handlers.trace() as sites:
                    said = program(evidence.of_numbers(*numbers))
                # an observer of answers without names may have a parameter of that name
                diversity = None if "diversity" in sites else draw.get("diversity")
                return expected(said, draw["spread"], diversity)

            return jax.lax.map(of_one, draws, batch_size=_AT_A_TIME)

        draws = {name: jnp.asarray(values) for name, values in self.draws.items()}
        found = jax.jit(of_all)(draws, evidence.numbers)
        return {question: np.asarray(values, np.float64) for question, values in found.items()}

    def predict(self, evidence: Evidence) -> dict[str, ppl.Prediction]:
        """Return event id -> prediction of people's answers, given evidence: a mean over draws."""
        return _predictions(evidence, {q: p.mean(axis=0) for q, p in self.shares(evidence).items()})

    def save(self, path: str | os.PathLike[str]) -> None:
        """Write the observer's name, questions and noise, and up to 200 draws, as JSON.

        Raises:
            OutputError: the file cannot be written, or its name does not end in .json.
        """
        ppl.files.write_json(path, self.to_dict())

    def to_dict(self) -> dict[str, Any]:
        """Return what :meth:`save` writes, as plain data for :meth:`from_dict`."""
        n = len(self.draws["spread"])
        kept = np.linspace(0, n - 1, min(n, KEPT)).round().astype(int)
        draws = {
            name: [float(f"{value:.5g}") for value in values[kept]]
            for name, values in self.draws.items()
        }
        return {
            "schema": SCHEMA,
            "observer": self.name,
            "questions": list(self.questions),
            "perception": None if self.perception is None else dataclasses.asdict(self.perception),
            "draws": draws,
        }

    @classmethod
    def from_dict(
        cls, record: Mapping[str, Any], observer: Program | None = None
    ) -> FittedObserver:
        """Return the observer that :meth:`to_dict` wrote.

        Args:
            record: plain data from :meth:`to_dict`.
            observer: the observer's program; needed unless it is a ready-made one.

        Raises:
            InvalidEventError: ``record`` is no fitted observer, or is damaged.
            InvalidSettingError: the program is missing.
            UnknownNameError: no ready-made observer has the name in ``record``.
        """
        if record.get("schema") != SCHEMA:
            raise ppl.errors.InvalidEventError(
                "this is no fitted observer: its schema is "
                f"{ppl.errors.shown(record.get('schema'))}, not {SCHEMA!r}"
            )
        name = str(record.get("observer", ""))
        if observer is None and not name:
            raise ppl.errors.InvalidSettingError(
                "the observer is user-defined: give its program as observer="
            )
        try:
            draws = {k: np.array(values, np.float64) for k, values in record["draws"].items()}
            seen, questions = record["perception"], tuple(map(str, record["questions"]))
            perception = None if seen is None else Perception(**seen)
        except (AttributeError, KeyError, TypeError, ValueError) as error:
            raise ppl.errors.InvalidEventError(f"a fitted observer is damaged: {error}") from None
        if "spread" not in draws or {d.shape for d in draws.values()} != {draws["spread"].shape}:
            raise ppl.errors.InvalidEventError(
                "a fitted observer is damaged: draws of unequal numbers"
            )
        return FittedObserver(observer or observer_named(name), name, draws, questions, perception)

    @classmethod
    def load(cls, path: str | os.PathLike[str], observer: Program | None = None) -> FittedObserver:
        """Read a file that :meth:`save` wrote; ``observer`` is as for :meth:`from_dict`.

        Raises:
            InvalidEventError: there is no such file, or it holds no fitted observer.
            InvalidSettingError, UnknownNameError: as for :meth:`from_dict`.
        """
        return cls.from_dict(ppl.read_json(path), observer)

    @classmethod
    def named(
        cls, name: str | os.PathLike[str], model: str, world: ppl.World | None = None
    ) -> FittedObserver:
        """Return "people", the observer that comes with the package, or an observer from a file.

        "people" was fitted to people's judgments of relations in 50 of PHASE's test videos.

        Args:
            name: "people", or a file that :meth:`save` wrote.
            model: name of the model whose answers the observer changes: "people" was fitted for
                each model apart. It does not matter for a file.
            world: world of the events; None: it is not checked to be PHASE.

        Raises:
            InvalidSettingError: the world is not PHASE, or there is no "people" for the model.
            InvalidEventError, UnknownNameError: the file cannot be used, as for :meth:`load`.
        """
        if world is not None:
            check_is_phase(world)
        if name != PEOPLE:
            return cls.load(name)
        known = json.loads(_FILE.read_text(encoding="utf-8"))
        if model not in known:
            raise ppl.errors.InvalidSettingError(
                f"observer 'people' comes for the models {', '.join(known)}, not for "
                f"{ppl.errors.shown(model)}: phase_ppl.fit_people makes one"
            )
        return cls.from_dict(known[model])

    @property
    def record(self) -> dict[str, Any]:
        """Name and hash of the observer, as plain data for an evaluation's settings."""
        digest = hashlib.sha256(json.dumps(self.to_dict()).encode()).hexdigest()
        return {"observer": self.name, "observer_digest": digest}

    def seeing(self, model: Callable[..., Any], world: ppl.World) -> Observed:
        """Return a model whose answers are those that this observer expects of people.

        Args:
            model: a function ``(scene, observation, seed)``.
            world: world of the events.

        Raises:
            InvalidSettingError: the world is not PHASE.
        """
        check_is_phase(world)
        return Observed(model, self)


def _predictions(evidence: Evidence, shares: Mapping[str, FloatArray]) -> dict[str, ppl.Prediction]:
    return {
        event: ppl.Prediction(event, {q: p[i] / p[i].sum() for q, p in shares.items()})
        for i, event in enumerate(evidence.events)
    }


@dataclasses.dataclass(frozen=True, eq=False)
class PeopleFit(FittedObserver):
    """An observer fitted to people's answers by NUTS; in ``draws`` one chain follows another.

    Attributes:
        evidence: the evidence about the videos that the fit used.
        answers: the people's answers that the fit used.
        chains: number of chains.
        log_likelihood: (draw, event) log likelihood of all people's answers about a video, in nats.
        seed: seed of the fit.
        warmup: number of warm-up steps of each chain.
    """

    evidence: Evidence
    answers: Answers
    chains: int
    log_likelihood: FloatArray
    seed: int
    warmup: int

    @functools.cached_property
    def arviz(self) -> Any:
        """The draws for ArviZ: ``az.summary``, ``az.loo``, and ``az.compare`` of several fits.

        Groups are ``posterior``, the parameters, and ``log_likelihood``, of all answers about each
        judged video. It is an ``arviz.InferenceData`` for ArviZ before 1, otherwise an
        :class:`xarray.DataTree`.
        """
        shape = (self.chains, -1)
        dims = ("chain", "draw")
        posterior = {n: (dims, v.reshape(shape)) for n, v in self.draws.items()}
        judged = np.flatnonzero(self.answers.judged)
        logs = self.log_likelihood[:, judged].reshape(*shape, len(judged))
        events = {"event": [self.evidence.events[i] for i in judged]}
        groups = {
            "posterior": xr.Dataset(posterior),
            "log_likelihood": xr.Dataset({"answers": ((*dims, "event"), logs)}, events),
        }
        return ppl.arviz_groups(groups)

    @functools.cached_property
    def _left_out_weights(self) -> tuple[FloatArray, FloatArray]:
        """Weights (event, draw) of the draws without each event, and Pareto's k."""
        return ppl.pareto_smoothed(-self.log_likelihood.T)

    @property
    def pareto_k(self) -> FloatArray:
        """(event,) Pareto's k: how far each video's answers move the draws.

        Above 0.7, :attr:`elpd` and :attr:`left_out` fit anew without the video.
        """
        return self._left_out_weights[1]

    @functools.cached_property
    def _doubtful(self) -> list[int]:
        return np.flatnonzero((self.pareto_k > UNRELIABLE) & (self.answers.judged > 0)).tolist()

    @functools.cached_property
    def _refits(self) -> dict[int, PeopleFit]:
        what = "fitting again without each doubtful video"
        return {i: self.without([i]) for i in ppl.counted(self._doubtful, None, "video", what)}

    def without(self, places: Sequence[int]) -> PeopleFit:
        """Return the fit to all events except those whose indices are ``places``."""
        left_out = np.zeros(len(self.evidence.events))
        left_out[list(places)] = 1
        return sampled(
            self.observer, self.name, self.evidence, self.answers, left_out=left_out,
            draws=len(self.draws["spread"]) // self.chains, warmup=self.warmup,
            chains=self.chains, seed=self.seed,
        )  # fmt: skip

    @property
    def _smoothed_elpd(self) -> FloatArray:
        weights = self._left_out_weights[0]
        return np.asarray(np.logaddexp.reduce(np.log(weights) + self.log_likelihood.T, axis=1))

    @functools.cached_property
    def elpd(self) -> FloatArray:
        """(event,) log predictive density of a video's answers under the fit without them, in nats.

        It is estimated from the draws of this fit. Where :attr:`pareto_k` exceeds 0.7, the observer
        is fitted anew without the video, which takes as long as this fit.
        """
        found = self._smoothed_elpd
        for i, fit in self._refits.items():
            logs = fit.log_likelihood[:, i]
            found[i] = np.logaddexp.reduce(logs) - np.log(len(logs))
        return found

    @functools.cached_property
    def left_out(self) -> dict[str, ppl.Prediction]:
        """Event id -> prediction of people's answers, by the fit to all other videos.

        Draws are weighted by Pareto-smoothed importance sampling (Vehtari, Gelman and Gabry 2017,
        Statistics and Computing 27). Where :attr:`pareto_k` exceeds 0.7, the observer is fitted
        anew.
        """
        weights = self._left_out_weights[0]
        shares = {
            question: np.einsum("es,sek->ek", weights, values)
            for question, values in self.shares(self.evidence).items()
        }
        for i, fit in self._refits.items():
            for question, values in fit.shares(self.evidence.at([i])).items():
                shares[question][i] = values[:, 0].mean(axis=0)
        return _predictions(self.evidence, shares)

    def __repr__(self) -> str:
        n = len(self._doubtful)
        return (
            f"<PeopleFit of {self.name or self.observer!r}: {int(self.answers.judged.sum())} "
            f"videos, ELPD {self._smoothed_elpd.sum():.1f}"
            + (f" (not reliable for {n} of them; .elpd fits again)>" if n else ">")
        )


@ppl.tracing()
def sampled(
    observer: Program,
    name: str,
    evidence: Evidence,
    answers: Answers,
    *,
    left_out: FloatArray | None = None,
    draws: int = 500,
    warmup: int = 500,
    chains: int = 2,
    seed: int = 0,
    progress: bool | None = False,
) -> PeopleFit:
    """Draw the parameters of an observer from their posterior given people's answers."""
    counted = answers.judged if left_out is None else answers.judged * (1 - left_out)
    questions = tuple(q for q in evidence.answers if q in answers.counts)
    given = _given(evidence, questions)
    mcmc = _sampler(observer, given, answers, draws, warmup, chains)
    mcmc.progress_bar = ppl.progress_is_shown(progress)  # NumPyro's, for each chain
    mcmc.run(jax.random.key(seed), jnp.asarray(counted), given.numbers)
    found = {k: np.asarray(v, np.float64) for k, v in mcmc.get_samples().items()}
    parameters = {k: v for k, v in found.items() if k not in _NOT_PARAMETERS and v.ndim == 1}
    logs = found["log_likelihood"]
    return PeopleFit(
        observer, name, parameters, questions, None, evidence, answers, chains, logs, seed, warmup
    )


@functools.lru_cache(maxsize=_REMEMBERED)
def _given(evidence: Evidence, questions: tuple[str, ...]) -> Evidence:
    return evidence.condensed() if questions == ("relation",) else evidence


@functools.lru_cache(maxsize=_REMEMBERED)
def _sampler(
    observer: Program, given: Evidence, answers: Answers, draws: int, warmup: int, chains: int
) -> MCMC:
    """Return a sampler, cached by data, so that fits without a video compile once."""

    def program(counted: Array, numbers: Any) -> None:
        people(observer, given.of_numbers(*numbers), answers, counted)

    return MCMC(
        NUTS(program, target_accept_prob=0.9, max_tree_depth=7), num_warmup=warmup,
        num_samples=draws, num_chains=chains, chain_method="sequential", progress_bar=False,
        jit_model_args=True,
    )  # fmt: skip


def as_observer(given: str | Program) -> tuple[Program, str]:
    """Return an observer given by name or as a program, and its name, "" for a program."""
    if isinstance(given, str):
        return observer_named(given), given
    if not callable(given):
        raise ppl.errors.InvalidSettingError(
            f"observer={ppl.errors.shown(given)}, expected a name or a program of evidence"
        )
    named = (name for name, one in OBSERVERS.items() if one == given)
    return given, next(named, "")


# --- models seen through an observer --------------------------------------------------------------


@dataclasses.dataclass(frozen=True, eq=False)
class Observed:
    """A model seen through an observer; other questions than the fitted ones stay the model's."""

    model: Callable[[ppl.Scene, ppl.Observation, int], Any]
    observer: FittedObserver

    def __call__(self, scene: ppl.Scene, observation: ppl.Observation, seed: int) -> ppl.Answer:
        """Return the expected answers of people."""
        perception = self.observer.perception
        readings = [observation]
        if perception is not None:
            readings = perception.readings(scene, observation, seed)
        given = [self.model(scene, one, seed) for one in readings]
        answers = [ppl.Answer.of(one) for one in given]
        told = [ppl.Prediction.of(answer.given) for answer in answers]
        made: list[Any] = [a.posterior or one for a, one in zip(answers, told, strict=True)]
        event = ppl.Event(scene, observation)
        evidence = evidence_of([event], {event.id: made})
        (expected,) = self.observer.predict(evidence).values()
        own = told[0]
        fitted = {q: p for q, p in expected.probabilities.items() if q in self.observer.questions}
        kept = {q: a for q, a in own.answers.items() if q not in fitted}
        prediction = ppl.Prediction(
            "",
            {**{q: own.probabilities[q] for q in kept if q in own.probabilities}, **fitted},
            kept,
            _summed([one.cost for one in told]),
            {q: e for q, e in own.errors.items() if q in kept},
        )
        return ppl.Answer(prediction, answers[0].artefacts)

    def warm_up(self) -> None:
        """Prepare what all processes share."""
        getattr(self.model, "warm_up", lambda: None)()


def _summed(costs: Sequence[Mapping[str, Any]]) -> dict[str, Any]:
    """Return the summed costs of all readings of a video; other entries are the first's."""
    return {
        name: value
        if isinstance(value, bool) or not isinstance(value, int | float)
        else sum(cost.get(name, 0) for cost in costs)
        for name, value in costs[0].items()
    }
