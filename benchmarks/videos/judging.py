"""How well a pair of goals explains an event, under a model's prior and simulator."""

from __future__ import annotations

import functools
import hashlib
import json
from collections.abc import Mapping
from typing import Any, NamedTuple

import common
import numpy as np

from phase_ppl.agents.config import PlannerConfig
from phase_ppl.evaluation.models.simple import Simple
from phase_ppl.evaluation.registry import model_info
from phase_ppl.models.effective import log_prior_of_effective
from phase_ppl.models.model import Model
from phase_ppl.simulator.contract import simulate_one
from phase_ppl.world.event import Event
from phase_ppl.world.hypothesis import Hypothesis
from videos.hypotheses import log_mean_exp

JUDGING_SEED = 5000
"""Apart from the seeds that a run is likely to have met."""

Pair = tuple[int, ...]


class Task(NamedTuple):
    """A pair of goals to be judged on an event, under a model's own prior and simulator.

    Attributes:
        event: with its true strengths.
        pair: goals of red and green.
        model: name by which ``evaluate`` knows it; options: its options, as JSON.
        identity: stands for all that bears on the joint, so not for the kernel: what was judged
            for one kernel holds for others.
        seeds: simulations.
    """

    event: Event
    pair: Pair
    model: str
    options: str
    identity: str
    seeds: int

    @property
    def name(self) -> str:
        return f"{self.event.id} {self.pair} {self.identity}"


def model_of(settings: Mapping[str, Any]) -> tuple[str, str, str] | None:
    """Return model, options and identity of a task from an evaluation's settings.

    None where it is of a model that is not SIMPLE.
    """
    program = settings["model_settings"].get("model")
    if program is None:
        return None
    identity = hashlib.sha256(json.dumps(program, sort_keys=True).encode()).hexdigest()[:16]
    options = dict(settings["options"])
    if program["planner"] is not None:  # of a planner that is no preset the options keep a text
        options["planner"] = program["planner"]
    return settings["model"], json.dumps(options), identity


def true_pair(event: Event) -> Pair:
    return common.true_hypothesis(event).effective_goals


@functools.cache
def program(model: str, options: str) -> Model:
    """Return the model that an evaluation's name and options (as JSON) stand for."""
    given = json.loads(options)
    if isinstance(given.get("planner"), dict):
        given["planner"] = PlannerConfig.from_dict(given["planner"])
    found = model_info(model).make(**given)
    assert isinstance(found, Simple)
    return found.model


def judge(task: Task) -> dict[str, Any]:
    """Return log prior + log mean likelihood of a pair of goals at the true strengths."""
    model = program(task.model, task.options)
    strengths = common.true_hypothesis(task.event).strengths
    hypothesis = Hypothesis(task.pair[0], task.pair[1], (0, 0), *strengths)
    simulator = model.build_simulator()
    seen = task.event.observation.positions
    errors = [
        simulate_one(simulator, task.event.scene, hypothesis, seed, seen).total_error
        for seed in range(JUDGING_SEED, JUDGING_SEED + task.seeds)
    ]
    given = {"strength_red": np.array(strengths[:1]), "strength_green": np.array(strengths[1:])}
    log_prior = log_prior_of_effective(model.prior, np.array([task.pair]), given)[0]
    return {"log_joint": float(log_mean_exp(errors) + log_prior)}
