"""What if: hypotheses of a posterior simulated anew, as they are and with something changed."""

from __future__ import annotations

import dataclasses
import functools
import math
import os
import textwrap
from collections.abc import Mapping, Sequence
from typing import Any, Final, NamedTuple

import numpy as np
import xarray as xr

from phase_ppl.agents.config import PlannerConfig
from phase_ppl.analysis.estimate import Estimate
from phase_ppl.analysis.weights import Rows
from phase_ppl.closed_loop.hidden_state import reconstructed
from phase_ppl.physics.pymunk_world import AWAY
from phase_ppl.render.video import Film, video
from phase_ppl.simulator.contract import Simulator, random_generator, simulate_trajectory
from phase_ppl.simulator.joint import JointSimulator, Past
from phase_ppl.simulator.processes import mapped
from phase_ppl.world.arrays import FloatArray
from phase_ppl.world.checks import number_of_workers, positive_number, whole_number
from phase_ppl.world.errors import InvalidSettingError, shown, unknown_name
from phase_ppl.world.goals import GOALS, goal_index, goal_literal, is_true
from phase_ppl.world.hypothesis import ALPHAS, Hypothesis
from phase_ppl.world.names import AGENTS, ENTITIES
from phase_ppl.world.observation import FRAMES_PER_SECOND
from phase_ppl.world.picture import preformatted
from phase_ppl.world.scene import Scene

WORLDS: Final = ("as it is", "changed")
_SURE: Final = 1.96
"""Errors from which on a difference is put down to the change."""

_FEWEST: Final = 2


@dataclasses.dataclass(frozen=True, eq=False)
class WhatIf:
    """Simulations of hypotheses drawn from a posterior, in one world or in two.

    Errors are those of so many simulations; that of the posterior is not in them.

    Attributes:
        event_id: of which event.
        change: what is changed, in words; "" where nothing is.
        begin: the frame that they go on from; 0 is the start.
        scenes: of each world.
        goals: (simulation, agent) the effective goals of the hypotheses as they are.
        poses: (world, simulation, time, entity, [x, y, angle]).
        removed: entities that the last world does without.
    """

    event_id: str
    change: str
    begin: int
    scenes: tuple[Scene, ...]
    goals: Sequence[tuple[int, int]]
    poses: FloatArray
    removed: tuple[int, ...] = ()

    @functools.cached_property
    def tracks(self) -> xr.DataArray:
        """(world, simulation, time, entity, coord), units and radians; NaN of what was removed.

        ``time`` is in simulated seconds from the start of the event.
        """
        poses = np.where(self.poses < AWAY / 2, np.nan, self.poses)
        if self.removed:
            poses[-1][:, :, list(self.removed)] = np.nan
        time = (self.begin + np.arange(poses.shape[2])) / FRAMES_PER_SECOND
        return xr.DataArray(
            poses,
            {
                "world": list(WORLDS[: len(poses)]),
                "time": ("time", time, {"units": "s"}),
                "entity": list(ENTITIES),
                "coord": ["x", "y", "angle"],
            },
            ("world", "simulation", "time", "entity", "coord"),
            "tracks",
        )

    def reached(self, agent: str, goal: str | None = None) -> xr.DataArray:
        """Return in which simulations an agent's goal is reached, and when.

        A goal to get something somewhere is reached when that is true for the first time; one to
        get or keep it away, if it is away at the end.

        Args:
            agent: "red agent" or "green agent", or "red", "green".
            goal: a goal of the agent; by default that of each hypothesis as it is.

        Returns:
            (world, simulation) simulated seconds from the start of the event; inf where it is not.

        Raises:
            UnknownNameError: there is no such agent or goal.
        """
        holder = _entity(agent, AGENTS)
        found = np.full(self.poses.shape[:2], np.inf)
        for world, scene in enumerate(self.scenes):
            for row, frames in enumerate(self.poses[world]):
                wanted = self.goals[row][holder] if goal is None else goal_index(goal)
                literal = goal_literal(wanted, holder)
                when = [t for t, one in enumerate(frames) if is_true(literal, one, scene)]
                if literal.positive and when:
                    found[world, row] = (self.begin + when[0]) / FRAMES_PER_SECOND
                elif when and when[-1] == len(frames) - 1:
                    found[world, row] = (self.begin + when[-1]) / FRAMES_PER_SECOND
        return xr.DataArray(
            found, {"world": list(WORLDS[: len(found)])}, ("world", "simulation"), "seconds"
        )

    def probability(self, agent: str, goal: str | None = None) -> list[Estimate]:
        """Return in each world the probability that an agent's goal is reached."""
        return [_share(row) for row in np.isfinite(self.reached(agent, goal).values)]

    def difference(self, agent: str, goal: str | None = None) -> Estimate:
        """Return how much more probable the change makes it that an agent's goal is reached.

        Simulations are compared in pairs, of one hypothesis and one seed.

        Raises:
            InvalidSettingError: nothing was changed.
        """
        if len(self.scenes) < len(WORLDS):
            raise InvalidSettingError("nothing was changed: there is no difference to speak of")
        before, after = np.isfinite(self.reached(agent, goal).values).astype(float)
        change, n = after - before, len(after)
        # as if there had been one more of either sort
        spread = ((change**2).sum() + 2) / (n + 2) - (change.sum() / (n + 2)) ** 2
        return Estimate(float(change.mean()), math.sqrt(spread / (n + 2)))

    def film(self, path: str | os.PathLike[str], simulation: int = 0) -> Film:
        """Write one of the simulations as a film, both worlds side by side where there are two.

        Raises:
            OutputError: another ending than .mp4 or .gif, or the file cannot be written.
        """
        first, *others = (world[simulation] for world in self.poses)
        if not others:
            return video(first, path, self.scenes[0])
        return video(
            first, path, self.scenes[0], compare=others[0], compare_scene=self.scenes[-1],
            captions=(WORLDS[0], self.change),
        )  # fmt: skip

    def __str__(self) -> str:
        n, frames = self.poses.shape[1:3]
        lines = [
            f"{self.event_id}: {n} hypotheses drawn from the posterior, simulated for "
            f"{(frames - 1) / FRAMES_PER_SECOND:.1f} s from "
            f"{self.begin / FRAMES_PER_SECOND:.1f} s on (simulated time)"
        ]
        for holder, agent in enumerate(AGENTS):
            if holder not in self.removed:
                lines.append(f"the {agent} reaches its goal: {self._told(agent)}")
        return "\n".join(textwrap.fill(line, 88, subsequent_indent="  ") for line in lines)

    def _told(self, agent: str) -> str:
        shares = self.probability(agent)
        median = [_median(row) for row in self.reached(agent).values]
        if len(shares) == 1:
            return f"{shares[0]}{median[0]}"
        words = f"{shares[0]}{median[0]} as it is, {shares[1]}{median[1]} with {self.change}"
        change = self.difference(agent)
        if abs(change) < _SURE * change.error:
            return f"{words}; no difference that so few simulations would show ({change})"
        if not self.removed:
            return f"{words}: {'more' if change > 0 else 'less'} often ({change})"
        names = " and ".join(f"the {ENTITIES[entity]}" for entity in self.removed)
        role = "in its way" if change > 0 else "of help"
        return f"{words}: {names} was {role} ({change})"

    def _repr_html_(self) -> str:
        return preformatted(self)

    def __repr__(self) -> str:
        return f"<what if of {self.event_id}: {self.change or 'nothing changed'}>"


def _share(hits: np.ndarray) -> Estimate:
    n = len(hits)
    cautious = (hits.sum() + 1) / (n + 2)
    return Estimate(float(hits.mean()), math.sqrt(cautious * (1 - cautious) / (n + 2)))


def _median(seconds: FloatArray) -> str:
    reached = seconds[np.isfinite(seconds)]
    return f" (after {np.median(reached):.1f} s)" if reached.size else ""


def _entity(name: object, among: Sequence[str] = ENTITIES) -> int:
    """Return the number of an entity by its name, or by its colour alone."""
    if isinstance(name, str):
        for number, known in enumerate(among):
            if name.strip().lower() in (known, known.split()[0]):
                return number
    raise unknown_name("entity", name, among)


@dataclasses.dataclass(frozen=True)
class Change:
    """What is done to the world; None: left as it is. See ``do`` of a posterior."""

    goal_red: str | int | None = None
    goal_green: str | int | None = None
    stated_goal_red: str | int | None = None
    stated_goal_green: str | int | None = None
    alpha: tuple[int, int] | None = None
    strength_red: float | None = None
    strength_green: float | None = None
    remove: str | Sequence[str] = ()
    walls: Any = None

    @property
    def removed(self) -> tuple[int, ...]:
        names = [self.remove] if isinstance(self.remove, str) else self.remove
        return tuple(_entity(name) for name in names)

    def hypothesis(self, h: Hypothesis) -> Hypothesis:
        """Return a hypothesis with the change: stated goals and alpha first, then effective."""
        stated = {
            "goal_red": self.stated_goal_red,
            "goal_green": self.stated_goal_green,
            "alpha": self.alpha,
            "strength_red": self.strength_red,
            "strength_green": self.strength_green,
        }
        h = dataclasses.replace(h, **_given(stated)).effective()
        return dataclasses.replace(
            h, **_given({"goal_red": self.goal_red, "goal_green": self.goal_green})
        )

    def scene(self, scene: Scene) -> Scene:
        return scene if self.walls is None else dataclasses.replace(scene, walls=self.walls)

    def __str__(self) -> str:
        words = []
        for name, value in _given(dataclasses.asdict(self)).items():
            if name == "remove":
                words += [f"the {ENTITIES[entity]} removed" for entity in self.removed]
            elif name == "walls":
                words.append("other walls")
            else:
                goal = "goal" in name
                words.append(f"{name} = {GOALS[goal_index(value)] if goal else value}")
        return ", ".join(words)


def _given(values: Mapping[str, Any]) -> dict[str, Any]:
    return {name: value for name, value in values.items() if value is not None}


class Source(NamedTuple):
    """What is known of the event and the run of a posterior, and its table of hypotheses."""

    event_id: str
    settings: Mapping[str, Any]
    scene: Scene
    observed: FloatArray
    table: Rows


def simulated(
    post: Source,
    change: Change | None,
    *,
    at: int,
    frames: int,
    n: int,
    seed: int,
    workers: int | None,
    simulator: Simulator | None = None,
) -> WhatIf:
    """Return hypotheses drawn from a posterior, simulated from a frame on.

    Args:
        post: where they are drawn from.
        change: what is changed in a second world; None: there is only one.
        at: frame to go on from; 0: the start.
        frames: to simulate, that one included.
        n, seed, workers, simulator: as of ``do``.
    """
    whole_number("n", n, _FEWEST)
    removed = () if change is None else change.removed
    of_run = post.settings.get("model", {}).get("simulator", "joint")
    joint = of_run == "joint" if simulator is None else isinstance(simulator, JointSimulator)
    if not joint and (at or removed):
        raise InvalidSettingError(
            f"a frame to go on from and entities to remove need the joint simulator, not {of_run}: "
            "another one always begins at the start, with all entities"
        )
    run = _simulator(post, simulator)
    scene = post.scene
    worlds: list[tuple[Scene, tuple[int, ...]]] = [(scene, ())]
    drawn = _drawn(post, n, seed)
    hypotheses = [drawn]
    if change is not None:
        worlds.append((change.scene(scene), removed))
        hypotheses.append([change.hypothesis(h) for h in drawn])
    past = reconstructed(scene, post.observed[: at + 1]) if at else None
    seeds = np.random.SeedSequence([seed, n]).generate_state(n).tolist()
    tasks = [
        (run, where, h, int(one), frames, past, gone)
        for (where, gone), rows in zip(worlds, hypotheses, strict=True)
        for h, one in zip(rows, seeds, strict=True)
    ]
    poses = np.array(list(mapped(_simulate, tasks, number_of_workers(workers), "simulation")))
    if at:  # a frame is the mean over a step, a state its end: show what was seen
        there = poses[:, 0, :, 0] > AWAY / 2
        poses[:, 0][there] = np.broadcast_to(post.observed[at], poses[:, 0].shape)[there]
    return WhatIf(
        post.event_id,
        "" if change is None else str(change),
        at,
        tuple(where for where, _ in worlds),
        [h.effective_goals for h in drawn],
        poses.reshape(len(worlds), n, *poses.shape[1:]),
        removed,
    )


def _simulator(post: Source, simulator: Simulator | None) -> Simulator:
    if simulator is not None:
        return simulator
    model = post.settings.get("model", {})
    if model.get("simulator", "joint") != "joint":
        raise InvalidSettingError(
            f"the run had a simulator of its own, {model['simulator']}: give it, simulator=..."
        )
    stored = model.get("planner")
    return JointSimulator("fast" if stored is None else PlannerConfig.from_dict(stored))


def _drawn(post: Source, n: int, seed: int) -> list[Hypothesis]:
    """Return hypotheses by their weights, each as often as that to within one (systematic)."""
    weights = np.cumsum(post.table.weights)
    places = (np.random.default_rng(seed).random() + np.arange(n)) / n
    rows = np.minimum(np.searchsorted(weights, places * weights[-1], "right"), len(weights) - 1)
    values = post.table.values
    return [
        Hypothesis(
            int(values["stated_goal_red"][row]),
            int(values["stated_goal_green"][row]),
            ALPHAS[int(values["alpha"][row])],
            float(values["strength_red"][row]),
            float(values["strength_green"][row]),
        )
        for row in rows
    ]


def _simulate(
    run: Simulator,
    scene: Scene,
    hypothesis: Hypothesis,
    seed: int,
    frames: int,
    past: Past | None,
    removed: tuple[int, ...],
) -> FloatArray:
    if not isinstance(run, JointSimulator):
        return simulate_trajectory(run, scene, hypothesis, seed, frames)
    steps = run.steps(scene, hypothesis.effective(), random_generator(seed), past, removed)
    return np.array([frame for frame, _ in (next(steps) for _ in range(frames))])


def length(post: Source, at: int | None, seconds: float | None) -> tuple[int, int]:
    """Return the frame to go on from, and how many frames to simulate from there, it included."""
    last = len(post.observed) - 1
    begin = 0 if at is None else at
    if isinstance(begin, bool) or not isinstance(begin, int) or not 0 <= begin <= last:
        raise InvalidSettingError(f"at={shown(at)}, expected a frame in 0..{last}")
    if seconds is not None:
        positive_number("seconds", seconds)
        return begin, max(1, round(seconds * FRAMES_PER_SECOND)) + 1
    if begin == last:
        raise InvalidSettingError(f"at={begin} is the last frame: say for how many seconds=")
    return begin, last - begin + 1
