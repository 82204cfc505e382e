"""What the closed-loop filter finds in a real video, kept in parts for other settings."""

from __future__ import annotations

import contextlib
import dataclasses
import functools
import time
from collections.abc import Sequence
from typing import Any, NamedTuple

import common
import numpy as np
from numpy.typing import NDArray

from phase_ppl.agents.config import PlannerConfig
from phase_ppl.closed_loop.frame_likelihood import log_likelihoods, shift_of
from phase_ppl.closed_loop.goal_filter import (
    ActionPolicy,
    GoalFilter,
    Plans,
    SearchSets,
    policies_of,
)
from phase_ppl.closed_loop.hidden_state import HiddenState, Tracking
from phase_ppl.models import priors
from phase_ppl.models.closed_loop import ClosedLoopLikelihood
from phase_ppl.models.effective import log_prior_of_effective
from phase_ppl.physics.actions import ACTION_NAMES, Action, executed
from phase_ppl.world.arrays import FloatArray
from phase_ppl.world.event import Event
from phase_ppl.world.goals import N_GOALS
from phase_ppl.world.hypothesis import RELATION_TABLE

ALIKE = 0.7
"""Nats within which two actions explain a frame equally well."""

_MIRRORED = {"TURN_LEFT": "TURN_RIGHT", "LEFT": "RIGHT", "UP_LEFT": "UP_RIGHT"}
_MIRRORED |= {"DOWN_LEFT": "DOWN_RIGHT"}
_MIRRORED |= {there: here for here, there in _MIRRORED.items()}


def recovered(record: dict[str, Any], event: Event) -> NDArray[np.int64]:
    """Return the recovered actions (step, agent), as executed in the video as it was shown.

    A reflection changes handedness, so what was to the left is to the right.
    """
    actions = np.array([[ACTION_NAMES.index(name) for name in pair] for pair in record["actions"]])
    actions = actions[: min(record["exact_rows"], event.observation.n_frames - 1)]
    if record["reflection"] != "none":
        swap = np.arange(len(Action))
        for here, there in _MIRRORED.items():
            swap[Action[here]] = Action[there]
        actions = swap[actions]
    turning = event.scene.turning
    return np.vectorize(lambda a: executed(int(a), turning))(actions)


class Told(HiddenState):
    """A filter that is told the actions."""

    def tell(self, pair: NDArray[np.int64]) -> None:
        self._log_share = np.full(len(Action) ** 2, -np.inf)
        self._log_share[pair[0] * len(Action) + pair[1]] = 0.0


def compare_with_replay(task: tuple[Event, dict[str, Any]]) -> dict[str, Any]:
    """Return how often actions and holds agree, over both agents, and of how many steps."""
    event, record = task
    actions = recovered(record, event)
    free, told = HiddenState(event.scene, Tracking()), Told(event.scene, Tracking())
    best = alike = held = 0
    seconds = 0.0
    for frame, pair in zip(event.observation.trajectory[1:], actions, strict=False):
        started = time.perf_counter()
        density = free.advance(frame)
        seconds += time.perf_counter() - started
        told.tell(pair)
        told.advance(frame)
        for agent, action in enumerate(pair):
            own = density.max(axis=1 - agent)
            best += int(own[action] >= own.max() - 1e-9)
            alike += int(own[action] > own.max() - ALIKE)
        held += int((free.best().held == told.best().held).sum())
    levels = np.array(Tracking().strengths)
    place = np.unravel_index(free.strengths().argmax(), (len(levels), len(levels)))
    strengths = np.mean(levels[list(place)] == record["strength_newton"])
    return {
        "steps": len(actions),
        "actions": best,
        "alike": alike,
        "held": held,
        "strengths": float(strengths),
        "seconds": seconds,
    }


@dataclasses.dataclass
class Kept:
    """Densities of all joint actions and what all sets of searches found, per step of a video.

    Attributes:
        truth: effective goals of red and green; levels: places of their strengths.
        steps: per step (plans, log density).
        strengths: (step, strength of red, of green) probabilities.
        unexplained: (step,) nats, as of :class:`phase_ppl.closed_loop.goal_filter.FrameReading`.
    """

    truth: tuple[int, ...]
    levels: tuple[int, int]
    steps: list[tuple[list[list[Plans]], FloatArray]]
    strengths: FloatArray
    unexplained: FloatArray
    log_peak: FloatArray
    seconds: float

    @property
    def n_steps(self) -> int:
        return len(self.steps)

    def log_likelihood(
        self, policy: ActionPolicy, weight: float, planner_seeds: int | None = None
    ) -> FloatArray:
        """Return (step, goal_red, goal_green) with other settings, or fewer sets of searches."""
        log_mass, found = log_prior().ravel(), []
        for plans, log_density in self.steps:
            policies, pairs = policies_of(plans[:planner_seeds], policy)
            first, (every,) = log_likelihoods(log_density, policies, pairs, 1)
            (shift,) = shift_of(first, every[None], log_mass)
            found.append(np.where(np.isnan(every), first + shift, every))
            log_mass = log_mass + weight * found[-1]
        return np.array(found).reshape(-1, N_GOALS, N_GOALS)

    def scores(self, table: FloatArray, weight: float) -> Scores:
        """Return how a summed table answers.

        Args:
            table: (goal_red, goal_green).
            weight: of every frame.
        """
        log_mass = log_prior() + weight * table
        mass = np.exp(log_mass - np.logaddexp.reduce(log_mass.ravel()))
        relations = np.array([mass[code == RELATION_TABLE].sum() for code in range(3)])
        answers = [mass.sum(axis=1), mass.sum(axis=0), relations]
        true = [*self.truth, int(RELATION_TABLE[self.truth])]
        of_true = [
            max(float(answer[code]), 1e-12) for answer, code in zip(answers, true, strict=True)
        ]
        right = [answer.argmax() == code for answer, code in zip(answers, true, strict=True)]
        sure = [answer.max() for answer in answers]
        return Scores(
            *(float(np.mean(part)) for part in (right[:2], sure[:2], np.log(of_true[:2]))),
            *(float(part[2]) for part in (right, sure, np.log(of_true))),
        )

    def surprise(self, likelihood: ClosedLoopLikelihood) -> FloatArray:
        """Return (step,) nats by which frames are less probable than a perfect match."""
        tables = self.log_likelihood(likelihood.policy, likelihood.frame_weight())
        before = log_prior() + likelihood.frame_weight() * np.vstack(
            [np.zeros((1, N_GOALS, N_GOALS)), tables.cumsum(axis=0)[:-1]]
        )
        flat = before.reshape(len(tables), -1)
        flat = flat - np.logaddexp.reduce(flat, axis=1)[:, None]
        found = np.logaddexp.reduce(flat + tables.reshape(flat.shape), axis=1)
        return np.asarray(self.log_peak - found)


HEAD = "goals right, sure, log score; relation"
"""Of the columns of :class:`Scores` as text."""


class Scores(NamedTuple):
    """Shares right, mean probabilities of the best and mean log probabilities of the truth."""

    goals: float
    goals_confidence: float
    goals_log_score: float
    relation: float
    relation_confidence: float
    relation_log_score: float

    def __str__(self) -> str:
        goals, relation = self[:3], self[3:]
        return "; ".join("{:.2f} {:.2f} {:6.3f}".format(*part) for part in (goals, relation))

    @classmethod
    def of(cls, rows: Sequence[Scores]) -> Scores:
        """Return the mean of some."""
        return cls(*np.mean(rows, axis=0).tolist())


class Recorder(SearchSets):
    """Sets that keep what their searches found, and the densities of frames."""

    def __init__(self, *arguments: Any) -> None:
        super().__init__(*arguments)
        self.searched: list[list[list[Plans]]] = []
        self.densities: list[FloatArray] = []
        advance = self.hidden.advance

        def advanced(*arguments: Any) -> FloatArray:
            self.densities.append(advance(*arguments))
            return self.densities[-1]

        self.hidden.advance = advanced  # type: ignore

    def plans(self, wanted: Sequence[NDArray[np.bool_]] | None = None) -> list[list[Plans]]:
        found = super().plans(wanted)
        self.searched.append(
            [
                [one._replace(intent_of=one.intent_of.astype(np.int16)) for one in pair]
                for pair in found
            ]
        )
        return found


def levels_of(event: Event) -> tuple[int, int]:
    """Return the places of the true strengths among the four levels."""
    levels = np.array(Tracking().strengths)
    newtons = common.true_hypothesis(event).strengths
    red, green = (int(np.abs(levels - one).argmin()) for one in newtons)
    return red, green


def record(event: Event, likelihood: ClosedLoopLikelihood, seed: int = 0) -> Kept:
    """Read a video and keep everything."""
    truth = common.true_hypothesis(event).effective_goals
    began = time.process_time()
    sets = Recorder(
        event.scene, PlannerConfig.fast(), likelihood.tracking, seed, 1, likelihood.planner_seeds
    )
    pairs = np.indices((N_GOALS, N_GOALS)).reshape(2, -1).T, log_prior().ravel()
    goals = GoalFilter(sets, likelihood.policy, likelihood.frame_weight(), pairs)
    with contextlib.closing(goals):
        readings = [goals.read(frame) for frame in event.observation.trajectory[1:]]
    seconds = time.process_time() - began
    unexplained, log_peak = (
        np.array([getattr(one, name) for one in readings]) for name in ("unexplained", "log_peak")
    )
    steps = list(zip(sets.searched, sets.densities, strict=True))
    levels = [len(likelihood.tracking.strengths)] * 2
    strengths = np.stack([one.strengths.reshape(levels) for one in readings])
    return Kept(truth, levels_of(event), steps, strengths, unexplained, log_peak, seconds)


@functools.cache
def log_prior() -> FloatArray:
    """Return (goal_red, goal_green) log prior masses of the uniform prior."""
    pairs = np.argwhere(np.ones((N_GOALS, N_GOALS), bool))
    strengths = dict.fromkeys(("strength_red", "strength_green"), np.full(len(pairs), 300.0))
    found = log_prior_of_effective(priors.named("uniform"), pairs, strengths)
    return (found - np.logaddexp.reduce(found)).reshape(N_GOALS, N_GOALS)
