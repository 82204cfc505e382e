"""People's answers as arrays, and how probable they are under an observer."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping, Sequence
from typing import Final, TypeAlias

import jax
import jax.numpy as jnp
import numpy as np
import numpyro
import numpyro.distributions as dist
import pandas as pd
import xarray as xr
from jax import Array
from scipy import special, stats

import phase_ppl as ppl
from phase_people.observers import (
    ANSWERS,
    HALF_LIVES,
    QUESTIONS,
    RELATIONS,
    Evidence,
    FloatArray,
    IntArray,
    Program,
    Responses,
)

_NODES: Final = 64  # quadrature points for what people share about a video
_STEPS: Final = 10  # damped Newton steps to the centre of these points


@dataclasses.dataclass(frozen=True, eq=False)
class Answers:
    """People's answers about some videos."""

    counts: Mapping[str, FloatArray]  # question -> (event, answer) numbers of people
    # (answer, [question, event, rater, answer]) single answers of people with names; empty where
    # only counts are known. A graded answer has a row for each share
    rows: IntArray
    raters: tuple[str, ...]  # names of the people
    times: IntArray  # (time, [event, rater]) of response times, which are in ``seconds``
    seconds: FloatArray  # (time,)
    shares: FloatArray | None = None  # (answer,) of graded answers; None: all are 1

    @classmethod
    def of(cls, events: Sequence[ppl.Event], study: ppl.Study | None = None) -> Answers:
        """Return the judgments that events carry, and the response times of a study."""
        found = {i: ppl.Judgments.of(event) for i, event in enumerate(events)}
        judged = {i: one for i, one in found.items() if one is not None and one.counts}
        counts = {
            question: np.zeros((len(events), len(labels))) for question, labels in QUESTIONS.items()
        }
        for event, one in judged.items():
            for question, given in one.counts.items():
                counts[question][event] = given
        counts = {question: n for question, n in counts.items() if n.any()}
        if not counts:
            some = any(one is not None and one.moments for one in found.values())
            how = ", but at moments of the films: moments=True fits to these" if some else ""
            raise ppl.errors.InvalidEventError(f"nobody judged any of the events{how}")
        named = all(one.responses for one in judged.values())
        names = sorted({who for one in judged.values() for who in one.responses} if named else ())
        place = {who: i for i, who in enumerate(names)}
        rows = [
            (q, event, place[who], labels.index(label), share)
            for event, one in judged.items()
            if named
            for who, given in one.responses.items()
            for q, (question, labels) in enumerate(QUESTIONS.items())
            if question in given
            for label, share in _shares(given[question]).items()
        ]
        ids = {event.id: i for i, event in enumerate(events)}
        times = [
            (ids[row.event], place[row.participant], row.response_time)
            for row in (() if study is None else _viewings(study).itertuples())
            if row.event in ids and row.participant in place and row.response_time > 0
        ]
        return cls(
            counts,
            np.array([row[:4] for row in rows], np.int64).reshape(-1, 4),
            tuple(names),
            np.array([row[:2] for row in times], np.int64).reshape(-1, 2),
            np.array([row[2] for row in times], np.float64),
            np.array([row[4] for row in rows], np.float64),
        )

    def by_rater(self, question: str) -> tuple[FloatArray, IntArray]:
        """Return the answers to a question by rater, with as many slots for each event.

        They are shares (slot, event, answer), 0 in slots that an event does not need, and indices
        of the raters (slot, event). Sums over such arrays are faster than over rows.
        """
        asked = self.rows[:, 0] == list(QUESTIONS).index(question)
        _, event, rater, answer = self.rows[asked].T
        slot = pd.Series(rater).groupby(event).rank("dense").to_numpy(int) - 1
        given = np.zeros((slot.max(initial=0) + 1, *self.counts[question].shape))
        np.add.at(given, (slot, event, answer), 1 if self.shares is None else self.shares[asked])
        who = np.zeros(given.shape[:2], np.int64)
        who[slot, event] = rater
        return given, who

    @property
    def judged(self) -> FloatArray:
        """(event,) 1 if anybody answered anything, else 0."""
        return np.any([n.any(axis=1) for n in self.counts.values()], axis=0).astype(float)


def _shares(answer: str | Mapping[str, float]) -> Mapping[str, float]:
    """Return label -> share of an answer."""
    return {answer: 1.0} if isinstance(answer, str) else answer


def _viewings(study: ppl.Study) -> pd.DataFrame:
    """Return a row for each whole film that somebody judged."""
    whole = study.table[study.table["at"].isna()]
    return whole.drop_duplicates(["event", "participant"])


def _normals(n: int) -> FloatArray:
    """Return (node, n) points that represent independent standard normals."""
    points = special.ndtri(stats.qmc.Sobol(n, seed=0).random(_NODES))
    return np.asarray((points - points.mean(axis=0)) / points.std(axis=0))


NORMALS: Final = {question: _normals(len(labels)) for question, labels in QUESTIONS.items()}


def shared(logs: Array, spread: Array | float, question: str) -> Array:
    """Return (node, event, answer) log probabilities, given what people share about a video.

    ``logs`` (event, answer) are the observer's. ``spread`` is the standard deviation of the log
    odds that people share about one video beyond the observer's. It makes them agree more than
    independent raters would.
    """
    moved = logs + spread * jnp.asarray(NORMALS[question])[:, None]
    return jax.nn.log_softmax(moved, axis=-1)


def about(
    counts: FloatArray, logs: Array, spread: Array | float, question: str
) -> tuple[Array, Array]:
    """Return (answer, node, event) log odds that people may share, and (node, event) log masses.

    A sum over nodes is the mean over standard normals times ``spread``. The nodes lie about the
    values that the numbers of answers (event, answer) make most probable, as widely as these allow
    (Laplace). With 64 nodes the error is at most 0.1 nats, for 20 answers about a relation and a
    spread of up to 2.5.
    """
    votes, logs = jnp.asarray(counts, logs.dtype).T, jax.lax.stop_gradient(logs).T
    given, n = jax.lax.stop_gradient(spread), votes.sum(axis=0)
    much = n * given**2

    def at(place: Array) -> tuple[Array, Array, Array, Array]:
        """Return shares, and the curvature: diag(d) less a matrix of rank one."""
        p = jax.nn.softmax(logs + given * place, axis=0)
        d = 1 + much * p
        return p, d, p / d, 1 - much * (p**2 / d).sum(axis=0)

    def newton(_: int, place: Array) -> Array:
        p, d, q, rest = at(place)
        slope = given * (votes - n * p) - place
        step = slope / d + much * q * (q * slope).sum(axis=0) / rest
        far = 1e-6 + given * jnp.ptp(step, axis=0)
        return place + step * jnp.log1p(far) / far

    place = jax.lax.fori_loop(0, _STEPS, newton, jnp.zeros_like(logs))
    p, d, _, rest = at(place)
    root = p / jnp.sqrt(d)
    normals = jnp.asarray(NORMALS[question]).T[:, :, None]
    along = (normals * root[:, None]).sum(axis=0) * (1 / jnp.sqrt(rest) - 1) / (root**2).sum(axis=0)
    moved = place[:, None] + (normals + along * root[:, None]) / jnp.sqrt(d)[:, None]
    log_mass = (normals**2 - moved**2 - jnp.log(d)[:, None]).sum(axis=0) - jnp.log(rest)
    return spread * moved, log_mass / 2 - jnp.log(_NODES)


_PLACES, _MASSES = np.polynomial.hermite_e.hermegauss(21)
_RATERS: Final = np.stack([_PLACES, _MASSES / _MASSES.sum()], axis=1)
"""(node, [place, mass]) of a standard normal: shares are off by 0.0003 at a diversity of 1.5."""


def expected(
    said: Responses, spread: Array | float, diversity: Array | float | None = None
) -> Responses:
    """Return question -> (event, answer) expected shares of people.

    They are a mean over what people share about a video (``spread``). If raters differ in how
    sharply they answer (``diversity`` as in :func:`people`), they are also a mean over raters, by
    Gauss-Hermite quadrature: together raters answer less sharply than the median one.
    """
    of_nodes = {question: shared(logs, spread, question) for question, logs in said.items()}
    if diversity is None:
        return {question: jnp.exp(logs).mean(axis=0) for question, logs in of_nodes.items()}

    def of_raters(node: Array) -> Responses:
        place, mass = node
        sharp = jnp.exp(diversity * place)
        return {
            q: mass * jax.nn.softmax(sharp * n, axis=-1).mean(axis=0) for q, n in of_nodes.items()
        }

    found: Responses = jax.lax.map(of_raters, jnp.asarray(_RATERS))
    return {question: shares.sum(axis=0) for question, shares in found.items()}


def people(observer: Program, evidence: Evidence, answers: Answers, counted: Array) -> None:
    """The program that is fitted: people answer as an observer does.

    What raters share about a video (``spread``) is integrated out, so that a video has one log
    likelihood (``log_likelihood``), of all its answers. Raters with names differ in how sharply
    they answer (``diversity``). A response time is log-normal about the rater's own pace (``pace``,
    ``pace_sd``), and longer by ``slowing`` for each nat of doubt about the relation. ``counted``
    (event,) is 1 for videos whose answers count, 0 for those left out.
    """
    said = observer(evidence)
    n_raters = len(answers.raters)
    spread = numpyro.sample("spread", dist.HalfNormal(1.0))
    total = jnp.zeros(len(evidence.events))
    if n_raters:
        diversity = numpyro.sample("diversity", dist.HalfNormal(0.5))
        with numpyro.plate("raters", n_raters):
            sharp = jnp.exp(diversity * numpyro.sample("rater", dist.Normal(0.0, 1.0)))
    for question in QUESTIONS:
        if question not in said or question not in answers.counts:
            continue
        counts = answers.counts[question]
        moved, log_mass = about(counts, said[question], spread, question)
        logs = jax.nn.log_softmax(said[question].T[:, None] + moved, axis=0)  # answer, node, event
        by_node = log_mass
        if n_raters:
            # the best answer is 0, so that powers of the others may vanish
            by_node += _by_rater(logs - logs.max(axis=0), sharp, *answers.by_rater(question))
        else:
            by_node += (counts.T[:, None] * logs).sum(axis=0)
        total += jax.nn.logsumexp(by_node, axis=0)
    if len(answers.seconds):
        total += _of_times(said, answers, n_raters, len(evidence.events))
    numpyro.deterministic("log_likelihood", total)
    numpyro.factor("answers", (counted * total).sum())


def _by_rater(logs: Array, sharp: Array, given: FloatArray, who: IntArray) -> Array:
    """Return (node, event) log probabilities of the answers of raters, who differ in ``sharp``."""
    powers = sharp[who]  # slot, event
    votes = (given * powers[..., None]).sum(axis=0)

    # several times faster than sums over an array with an axis of slots
    def add(total: Array, slot: tuple[Array, Array]) -> tuple[Array, None]:
        power, n = slot
        return total + n * jnp.log(jnp.exp(power * logs).sum(axis=0)), None

    start = jnp.zeros(logs.shape[1:])
    norms, _ = jax.lax.scan(add, start, (powers, jnp.asarray(given.sum(axis=-1))))
    return (votes.T[:, None] * logs).sum(axis=0) - norms


def _of_times(said: Responses, answers: Answers, n_raters: int, n_events: int) -> Array:
    logs = said["relation"]
    doubt = -(jnp.exp(logs) * logs).sum(axis=-1)
    pace = numpyro.sample("pace", dist.Normal(2.0, 2.0))
    spread = numpyro.sample("pace_sd", dist.HalfNormal(1.0))
    with numpyro.plate("paces", n_raters):
        own = spread * numpyro.sample("own_pace", dist.Normal(0.0, 1.0))
    slowing = numpyro.sample("slowing", dist.Normal(0.0, 1.0))
    noise = numpyro.sample("time_noise", dist.HalfNormal(1.0))
    event, rater = answers.times.T
    law = dist.LogNormal(pace + own[rater] + slowing * doubt[event], noise)
    return jnp.zeros(n_events).at[event].add(law.log_prob(jnp.asarray(answers.seconds)))


# --- a model's results as evidence ----------------------------------------------------------------

Made: TypeAlias = "ppl.Posterior | ppl.ClosedLoopPosterior | ppl.Prediction | None"
"""A model's result for a video; None: only surface cues are known."""

FLOOR: Final = 0.01
"""Share of a sampler's or a network's probabilities that is spread evenly. A hypothesis that it
never met need not be impossible."""

_LOWEST: Final = -1e4
"""Nats in place of minus infinity, whose differences are undefined."""

_N: Final = ANSWERS["goal_red"]
PAIRS: Final = {
    "relation": np.array(
        [RELATIONS.index(ppl.Truth(one, two).relation) for one in ppl.GOALS for two in ppl.GOALS]
    ),
    "goal_red": np.repeat(np.arange(_N), _N),
    "goal_green": np.tile(np.arange(_N), _N),
}
_RELATIONS_ONLY: Final = {"relation": np.arange(len(RELATIONS))}


def check_is_phase(world: ppl.World, what: str = "an observer of people") -> None:
    """Raise InvalidSettingError unless the world is PHASE."""
    if world != ppl.worlds.PHASE:
        raise ppl.errors.InvalidSettingError(
            f"{what} knows the world PHASE only, not {world.name!r}"
        )


def evidence_of(
    events: Sequence[ppl.Event], made: Mapping[str, Made | Sequence[Made]] | None = None
) -> Evidence:
    """Return the evidence of observers: scene and observation of the events, and model results.

    ``made`` has a model's result for each event, or for each of several readings of it; None:
    surface cues alone. Hypotheses are pairs of goals for a posterior, relations for a prediction.

    InvalidSettingError: an event is of another world than PHASE.
    """
    for event in events:
        check_is_phase(event.scene.world)
    readings: list[list[Made]] = []
    for event in events:
        one = None if made is None else made.get(event.id)
        if made is not None and one is None:
            raise ppl.errors.InvalidSettingError(
                f"the model made nothing of the event {event.id!r}"
            )
        readings.append(list(one) if isinstance(one, Sequence) else [one])
    tables = [
        [_table(event.id, one) for one in of] for event, of in zip(events, readings, strict=True)
    ]
    sizes = {(len(of), of[0][1].size) for of in tables}
    if len(sizes) > 1:
        raise ppl.errors.InvalidSettingError(
            "some events have a posterior, others a prediction only, or other numbers of readings"
        )
    likelihood = np.array([[one[0] for one in of] for of in tables])  # event, percept, leak, h
    pairs = sizes == {(len(tables[0]), _N**2)}
    cues = [ppl.cues.surface(event.scene, event.observation) for event in events]
    return Evidence(
        tuple(event.id for event in events),
        np.maximum(np.moveaxis(likelihood, (2, 1), (0, 1)), _LOWEST),
        np.maximum(np.array([of[0][1] for of in tables]), _LOWEST),
        PAIRS if pairs else _RELATIONS_ONLY,
        {name: np.array([one[name] for one in cues]) for name in ppl.cues.CUES},
    )


def _table(event_id: str, made: Made) -> tuple[FloatArray, FloatArray]:
    """Return log likelihoods (half-life, hypothesis), the best 0, and log priors (hypothesis,)."""
    if made is None:
        n = len(RELATIONS)
        return np.zeros((len(HALF_LIVES), n)), np.full(n, -np.log(n))
    if isinstance(made, ppl.Prediction):
        if "relation" not in made.probabilities:
            raise ppl.errors.InvalidSettingError(
                f"event {event_id!r}: no probabilities of relations are given"
            )
        shares = made.probabilities["relation"]
    elif (frames := made.by_frame()) is not None:
        return _of_frames(frames)
    else:
        shares = made.joint("goal_red", "goal_green").values.ravel()
    n = len(shares)
    log_likelihood = np.log((1 - FLOOR) * shares * n + FLOOR)
    tables = np.tile(log_likelihood - log_likelihood.max(), (len(HALF_LIVES), 1))
    return tables, np.full(n, -np.log(n))


def _of_frames(seen: xr.Dataset) -> tuple[FloatArray, FloatArray]:
    frames = seen["log_likelihood"].values.reshape(seen.sizes["time"], -1)
    age = np.arange(len(frames))[::-1, None]
    found = np.array([(0.5 ** (age / life) * frames).sum(axis=0) for life in HALF_LIVES])
    prior = seen["log_prior"].values.ravel()
    possible = np.isfinite(prior)
    return found - found[:, possible].max(axis=1, keepdims=True), prior
