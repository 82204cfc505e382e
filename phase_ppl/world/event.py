"""An event: a scene, what was seen in it, and perhaps what is known about it."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping
from typing import Any

from phase_ppl.world.arrays import BoolArray, FloatArray, IntArray
from phase_ppl.world.checks import instance_of
from phase_ppl.world.errors import InvalidSettingError, shown, unknown_name
from phase_ppl.world.goals import GOALS, goal_index
from phase_ppl.world.hypothesis import (
    RELATIONS,
    SCENARIOS,
    Hypothesis,
    Roles,
    checked_strength,
    relation,
    scenario,
)
from phase_ppl.world.names import Literal
from phase_ppl.world.observation import FRAMES_PER_SECOND, Observation
from phase_ppl.world.picture import drawn
from phase_ppl.world.scene import PHASE, Scene, check_inside


@dataclasses.dataclass(frozen=True, eq=False)
class Thoughts:
    """What all agents thought; step k is decided at frame k and leads to frame k + 1."""

    subgoals: tuple[tuple[Literal, Literal], ...]  # (step, agent) what each was about
    actions: IntArray  # (step, agent) what it did, an index into the names of actions
    # (step, agent) share of its belief particles in which that was the subgoal
    agreeing: FloatArray
    seen: BoolArray  # (step, agent, entity) whether it had the entity in view
    held: IntArray  # (step, agent) the item that it held, or ``NOTHING``
    # (step, agent, particle, entity, [x, y, angle]) its beliefs, units and radians
    particles: FloatArray


@dataclasses.dataclass(frozen=True)
class Truth:
    """What generated an event of PHASE: effective goals, and whatever else is known.

    Attributes:
        goal_red, goal_green: effective goals, paper strings.
        relation, scenario: derived from the goals where not given.
        strength_red, strength_green: newtons, or None.

    Raises:
        UnknownNameError: a goal, relation or scenario is unknown.
        InvalidSettingError: a strength is no positive force.
    """

    goal_red: str
    goal_green: str
    relation: str = ""
    scenario: str = ""
    strength_red: float | None = None
    strength_green: float | None = None

    def __post_init__(self) -> None:
        for name in ("goal_red", "goal_green"):
            object.__setattr__(self, name, GOALS[goal_index(getattr(self, name))])
        if not self.scenario:
            object.__setattr__(self, "scenario", scenario(self.goal_red, self.goal_green))
        if not self.relation:
            object.__setattr__(self, "relation", relation(self.goal_red, self.goal_green))
        if self.relation not in RELATIONS:
            raise unknown_name("relation", self.relation, RELATIONS)
        if self.scenario not in SCENARIOS:
            raise unknown_name("scenario", self.scenario, SCENARIOS)
        for name in ("strength_red", "strength_green"):
            value = getattr(self, name)
            if value is not None:
                object.__setattr__(self, name, checked_strength(f"truth.{name}", value))

    @classmethod
    def of(cls, hypothesis: Hypothesis | Roles) -> Truth:
        """Return the truth of an event that was generated under a hypothesis."""
        red, green = (GOALS[goal] for goal in hypothesis.effective_goals)
        one, other = hypothesis.strengths
        return cls(red, green, strength_red=one, strength_green=other)


@dataclasses.dataclass(frozen=True, eq=False, repr=False)
class Event:
    """One social event. Inference reads ``scene`` and ``observation`` only.

    Attributes:
        scene: what is known before anybody moves.
        observation: the trajectories.
        id: name of the event; of no meaning to inference.
        truth: what generated it, if known: a ``Truth`` in PHASE, ``Roles`` in another world.
        judgments: human judgments, as read from the file.
        predictions: stored predictions of other models, as read from the file.
        thoughts: what the agents thought, of events that were simulated just now; not in files.

    Raises:
        InvalidEventError: the trajectory leaves the arena.
    """

    scene: Scene
    observation: Observation
    id: str = "event"
    truth: Any = None
    judgments: Mapping[str, Any] | None = None
    predictions: Mapping[str, Any] | None = None
    thoughts: Thoughts | None = None

    def __post_init__(self) -> None:
        instance_of("scene", self.scene, Scene, "a phase_ppl.Scene")
        instance_of("observation", self.observation, Observation, "a phase_ppl.Observation")
        check_inside(self.observation.trajectory, self.scene, "trajectory")
        of_phase = self.scene.world == PHASE
        if self.truth is not None and isinstance(self.truth, Truth) is not of_phase:
            kind = "a phase_ppl.Truth" if of_phase else "Roles"
            raise InvalidSettingError(
                f"truth={shown(self.truth)}, expected {kind} in the world {self.scene.world.name}"
            )

    def __repr__(self) -> str:
        seconds = (self.observation.n_frames - 1) / FRAMES_PER_SECOND
        words = f"{self.id}: {self.observation.n_frames} frames, {seconds:.1f} s simulated"
        if isinstance(self.truth, Roles):
            words += f"; {self.truth}"
        elif self.truth is not None:
            words += f"; red: {self.truth.goal_red}, green: {self.truth.goal_green}"
            words += f", {self.truth.relation}"
        return f"<event {words}>"

    def _repr_html_(self) -> str:
        return drawn(self.scene, self.observation.trajectory, repr(self)[7:-1])
