"""What observers go by: tables of a model's evidence and surface cues, of many videos."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Final, TypeAlias

import numpy as np

from phase_ppl.analysis.hypotheses import Hypotheses
from phase_ppl.analysis.stepwise_posterior import StepwisePosterior
from phase_ppl.analysis.stepwise_table import log_prior_of_pairs
from phase_ppl.evaluation.prediction import Prediction
from phase_ppl.models.observer.cues import CUES, surface_cues
from phase_ppl.models.observer.observers import HALF_LIVES, Evidence
from phase_ppl.world.arrays import FloatArray
from phase_ppl.world.errors import InvalidSettingError
from phase_ppl.world.event import Event
from phase_ppl.world.goals import N_GOALS
from phase_ppl.world.hypothesis import RELATION_TABLE, RELATIONS

Made: TypeAlias = Hypotheses | Prediction | None
"""What a model made of a video; None: surface cues are all there is."""

FLOOR: Final = 0.01
"""Share of a sampler's or a network's probabilities that is spread evenly: of what it never met
it does not know that it is impossible."""

_LOWEST: Final = -1e4
"""Nats in place of minus infinity, of which single precision has no differences."""

PAIRS: Final = {
    "relation": RELATION_TABLE.ravel().astype(np.int64),
    "goal_red": np.repeat(np.arange(N_GOALS), N_GOALS),
    "goal_green": np.tile(np.arange(N_GOALS), N_GOALS),
}
_RELATIONS_ONLY: Final = {"relation": np.arange(len(RELATIONS))}


def evidence_of(
    events: Sequence[Event], made: Mapping[str, Made | Sequence[Made]] | None = None
) -> Evidence:
    """Return what observers have to go by.

    Of a posterior the hypotheses are pairs of goals, of a prediction the relations alone.

    Args:
        events: scene and observation are read, nothing else.
        made: event id -> what a model made of it, or of several readings of it; None: no model,
            surface cues alone.
    """
    readings: list[list[Made]] = []
    for event in events:
        one = None if made is None else made.get(event.id)
        if made is not None and one is None:
            raise InvalidSettingError(f"the model made nothing of the event {event.id!r}")
        readings.append(list(one) if isinstance(one, Sequence) else [one])
    tables = [
        [_table(event.id, one) for one in of] for event, of in zip(events, readings, strict=True)
    ]
    sizes = {(len(of), of[0][1].size) for of in tables}
    if len(sizes) > 1:
        raise InvalidSettingError(
            "some events have a posterior, others a prediction only, or other numbers of readings"
        )
    likelihood = np.array([[one[0] for one in of] for of in tables])  # event, percept, leak, h
    pairs = sizes == {(len(tables[0]), N_GOALS**2)}
    cues = [surface_cues(event.scene, event.observation) for event in events]
    return Evidence(
        tuple(event.id for event in events),
        np.maximum(np.moveaxis(likelihood, (2, 1), (0, 1)), _LOWEST),
        np.maximum(np.array([of[0][1] for of in tables]), _LOWEST),
        PAIRS if pairs else _RELATIONS_ONLY,
        {name: np.array([one[name] for one in cues]) for name in CUES},
    )


def _table(event_id: str, made: Made) -> tuple[FloatArray, FloatArray]:
    """Return log likelihoods (half-life, hypothesis), the best 0, and log priors (hypothesis,)."""
    if made is None:
        n = len(RELATIONS)
        return np.zeros((len(HALF_LIVES), n)), np.full(n, -np.log(n))
    if isinstance(made, StepwisePosterior):
        return _of_frames(made)
    if isinstance(made, Prediction):
        if "relation" not in made.probabilities:
            raise InvalidSettingError(
                f"event {event_id!r}: no probabilities of relations are given"
            )
        shares = made.probabilities["relation"]
    else:
        shares = made.joint("goal_red", "goal_green").values.ravel()
    n = len(shares)
    log_likelihood = np.log((1 - FLOOR) * shares * n + FLOOR)
    tables = np.tile(log_likelihood - log_likelihood.max(), (len(HALF_LIVES), 1))
    return tables, np.full(n, -np.log(n))


def _of_frames(post: StepwisePosterior) -> tuple[FloatArray, FloatArray]:
    frames = post.dataset["log_likelihood"].values.reshape(post.dataset.sizes["time"], -1)
    age = np.arange(len(frames))[::-1, None]
    found = float(post.dataset.attrs["weight"]) * np.array(
        [(0.5 ** (age / half_life) * frames).sum(axis=0) for half_life in HALF_LIVES]
    )
    prior = log_prior_of_pairs(post.dataset["log_prior"].values).ravel()
    possible = np.isfinite(prior)
    return found - found[:, possible].max(axis=1, keepdims=True), prior
