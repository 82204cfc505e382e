"""What if: simulations of a posterior's hypotheses, unchanged and with a change."""

from __future__ import annotations

import dataclasses
import functools
import math
import os
import textwrap
from collections import Counter
from collections.abc import Iterable, Mapping, Sequence
from typing import Any, Final

import numpy as np
import pandas as pd
import xarray as xr
from scipy.special import bdtr

from phase_ppl.agents.config import PlannerConfig
from phase_ppl.analysis.estimate import Estimate, cautious
from phase_ppl.closed_loop.hidden_state import Tracking, reconstructed
from phase_ppl.physics.pymunk_world import AWAY
from phase_ppl.render.video import Film, video
from phase_ppl.simulator.contract import Simulator, random_generator, simulate_trajectory
from phase_ppl.simulator.joint import JointSimulator, Past
from phase_ppl.simulator.processes import mapped
from phase_ppl.world.arrays import FloatArray
from phase_ppl.world.errors import (
    InvalidSettingError,
    instance_of,
    number_of_workers,
    positive_number,
    shown,
    unknown_name,
    whole_number,
)
from phase_ppl.world.event import FRAMES_PER_SECOND
from phase_ppl.world.goals import goal_index, goal_literal, is_true, planned_as
from phase_ppl.world.hypothesis import ALPHAS, Hypothesis, checked_strength, towards_whom
from phase_ppl.world.names import Literal, PredicateKind
from phase_ppl.world.picture import Printed
from phase_ppl.world.scene import Scene, World
from phase_ppl.world.space import ALPHA_SITE, space_of

WORLDS: Final = ("as it is", "changed")
_BY_CHANCE: Final = 0.05
"""Significance level of the sign test of the pairs (two-sided p)."""

_FEWEST: Final = 2
_SHOWN: Final = 3  # goals of an agent that are printed


@dataclasses.dataclass(frozen=True, eq=False)
class WhatIf(Printed):
    """Simulations of hypotheses drawn from a posterior, unchanged and perhaps with a change.

    The axis ``world`` has "as it is" and, if there was a change, "changed". Errors come from the
    number of simulations only; the posterior's own error is not included.

    Attributes:
        event_id: id of the event.
        change: the change, in words; "": none.
        begin: first frame of the simulations; 0 is the start.
        scenes: (world,) the scene as it is, then the changed one.
        goals: (simulation, agent) effective goals of the unchanged hypotheses, indices into
            ``world.goals``.
        poses: (world, simulation, time, entity, [x, y, angle]), units and radians. Removed entities
            are far outside the arena; in :attr:`tracks` they are NaN.
        removed: indices of the entities that are missing from the changed world.
        is_removal: whether a removal is the only change.
    """

    event_id: str
    change: str
    begin: int
    scenes: tuple[Scene, ...]
    goals: Sequence[tuple[int, ...]]
    poses: FloatArray
    removed: tuple[int, ...] = ()
    is_removal: bool = False

    @property
    def world(self) -> World:
        """The world of the event: its agents and goals."""
        return self.scenes[0].world

    @functools.cached_property
    def tracks(self) -> xr.DataArray:
        """(world, simulation, time, entity, coord) poses, units and radians; NaN: removed entity.

        ``time`` is in simulated seconds from the start of the event.
        """
        poses = np.where(self.poses < AWAY / 2, np.nan, self.poses)
        poses[-1][:, :, list(self.removed)] = np.nan
        time = (self.begin + np.arange(poses.shape[2])) / FRAMES_PER_SECOND
        coords = {"time": ("time", time, {"units": "s"}), "entity": list(self.world.entities)}
        coords |= {"world": list(WORLDS[: len(poses)]), "coord": ["x", "y", "angle"]}
        dims = ("world", "simulation", "time", "entity", "coord")
        return xr.DataArray(poses, coords, dims, "tracks")

    def reached(self, agent: str, goal: str | None = None) -> xr.DataArray:
        """Return the time at which each simulation reaches an agent's goal.

        A goal to get something somewhere is reached when that is first true. A goal to get or keep
        something away is reached, in the last frame, if it is away then. A removed entity counts as
        away from everything.

        Args:
            agent: name of the agent, such as "red agent", or the first word of the name.
            goal: a goal of the agent; by default its goal in each unchanged hypothesis.

        Returns:
            (world, simulation) simulated seconds from the start of the event; inf: not reached.

        Raises:
            UnknownNameError: there is no such agent or goal.
        """
        holder = _entity(agent, self.world.agents)
        found = np.full(self.poses.shape[:2], np.inf)
        for world, row in np.ndindex(found.shape):
            scene, frames = self.scenes[world], self.poses[world, row]
            wanted = self.goals[row][holder] if goal is None else goal_index(goal, self.world)
            literal = goal_literal(wanted, holder, self.world)
            near = self._wanted_near(literal, holder) if world else None
            when = [
                t
                for t, one in enumerate(frames)
                if (is_true(literal, one, scene) if near is None else not near)
            ]
            if when and (literal.positive or when[-1] == len(frames) - 1):
                frame = when[0] if literal.positive else when[-1]
                found[world, row] = (self.begin + frame) / FRAMES_PER_SECOND
        coords = {"world": list(WORLDS[: len(found)])}
        return xr.DataArray(found, coords, ("world", "simulation"), "seconds")

    def _wanted_near(self, literal: Literal, holder: int) -> bool | None:
        """Return whether a goal wants a removed entity near something; None: it is about others."""
        planned = planned_as(literal, holder, self.scenes[0])
        touched = [planned.target] if planned.predicate is PredicateKind.TOUCH else []
        about_it = not {planned.subject, *touched}.isdisjoint(self.removed)
        return planned.positive if about_it else None

    def _about_removed(self, agent: str) -> bool:
        """Return whether some of an agent's unchanged goals are about what is removed."""
        holder = _entity(agent, self.world.agents)
        literals = (goal_literal(row[holder], holder, self.world) for row in self.goals)
        return any(self._wanted_near(literal, holder) is not None for literal in literals)

    def probability(self, agent: str, goal: str | None = None) -> list[Estimate]:
        """Return for each world the probability of reaching a goal, as in :meth:`reached`."""
        shares = np.isfinite(self.reached(agent, goal).values).mean(axis=1).tolist()
        return [Estimate(share, cautious(share, len(self.goals))[1]) for share in shares]

    def difference(self, agent: str, goal: str | None = None) -> Estimate:
        """Return by how much the change raises the probability that an agent reaches its goal.

        Simulations are paired: both of a pair have the same hypothesis and seed.

        Args:
            agent, goal: the agent and its goal, as in :meth:`reached`.

        Raises:
            InvalidSettingError: nothing was changed.
            UnknownNameError: there is no such agent or goal.
        """
        if len(self.scenes) < len(WORLDS):
            raise InvalidSettingError("nothing was changed: there is no difference to speak of")
        before, after = np.isfinite(self.reached(agent, goal).values).astype(float)
        change, n = after - before, len(after)
        # with one more of either kind added
        spread = ((change**2).sum() + 2) / (n + 2) - (change.sum() / (n + 2)) ** 2
        return Estimate(float(change.mean()), math.sqrt(spread / (n + 2)))

    def film(self, path: str | os.PathLike[str], simulation: int = 0) -> Film:
        """Write one simulation as a film, with both worlds side by side if there was a change.

        Args:
            path: the file, ending in .mp4.
            simulation: number of the simulation, from 0.

        Raises:
            OutputError: ``path`` has another ending, or cannot be written.
        """
        first, *others = (world[simulation] for world in self.poses)
        beside: dict[str, Any] = {}
        if others:
            beside = {"compare": others[0], "compare_scene": self.scenes[-1]}
            which = f"simulation {simulation} of 0 to {len(self.goals) - 1}"
            beside["captions"] = (f"{which}, {WORLDS[0]}", self.change)
        return video(first, path, self.scenes[0], **beside)

    def __str__(self) -> str:
        n, frames = self.poses.shape[1:3]
        lines = [
            f"{self.event_id}: {n} hypotheses drawn from the posterior, simulated for "
            f"{(frames - 1) / FRAMES_PER_SECOND:.1f} s from "
            f"{self.begin / FRAMES_PER_SECOND:.1f} s on (simulated time)"
        ]
        there = [one for n, one in enumerate(self.world.agents) if n not in self.removed]
        for one in there:
            inline, listed = self._goals(one)
            lines.append(f"the {one} reaches its goal{inline}: {self._told(one)}{listed}")
        return "\n".join(textwrap.fill(line, 88, subsequent_indent="  ") for line in lines)

    def _goals(self, agent: str) -> tuple[str, str]:
        """Return an agent's unchanged goal; or several, each with its number of simulations."""
        held = Counter(row[self.world.agent(agent)] for row in self.goals).most_common()
        names = [self.world.goals[goal] for goal, _ in held]
        if len(held) == 1:
            return f" ({names[0]})", ""
        listed = [f"{name} ({n})" for name, (_, n) in zip(names[:_SHOWN], held, strict=False)]
        more = f", {len(held) - _SHOWN} more" if len(held) > _SHOWN else ""
        return "", f". Goals drawn: {', '.join(listed)}{more}"

    def _told(self, agent: str) -> str:
        seconds, told, about = self.reached(agent).values, [], self._about_removed(agent)
        holder = _entity(agent, self.world.agents)
        # one to get or keep away has no time: it counts at the end
        literals = (goal_literal(row[holder], holder, self.world) for row in self.goals)
        timed = np.array([literal.positive for literal in literals])
        median = "median" if timed.all() else "median of goals to get somewhere"
        for share, row in zip(self.probability(agent), seconds, strict=True):
            reached = row[np.isfinite(row) & timed]
            after = np.median(reached) if reached.size else np.inf
            when = "" if np.isinf(after) else f" (reached at {after:.1f} s, {median})"
            if self.begin and after <= self.begin / FRAMES_PER_SECOND:
                when = " (it is reached already)"
            told.append(f"{share}{when if timed.any() else ' (true at the end)'}")
        if len(told) == 1:
            return f"probability {told[0]}"
        if about:
            told[1] = f"{told[1].partition(' (')[0]} (what is removed counts as far away)"
        change, (before, after) = self.difference(agent), np.isfinite(seconds)
        either = [int((after & ~before).sum()), int((before & ~after).sum())]
        if 2 * bdtr(min(either), sum(either), 0.5) > _BY_CHANCE:
            so = "may be chance"
        elif self.is_removal and not about:
            names = " and ".join(f"the {self.world.entities[entity]}" for entity in self.removed)
            so = f"{names} was {'in its way' if change > 0 else 'of help'}"
        else:
            so = f"{'more' if change > 0 else 'less'} often"
        both = f"without the change: {told[0]}; with {self.change}: {told[1]}"
        return f"probability {both}; difference {change}: {so}"

    def __repr__(self) -> str:
        return f"<what if of {self.event_id}: {self.change or 'nothing changed'}>"


def _entity(name: object, among: Sequence[str]) -> int:
    """Return the number of an entity by its name, or by the first word of one name only."""
    said = str(name).strip().lower()
    names = [known.lower() for known in among]
    first_words = [known.split()[0] for known in names]
    for known in (names, first_words):
        if known.count(said) == 1:
            return known.index(said)
    raise unknown_name("entity", name, among)


@dataclasses.dataclass(frozen=True)
class Change:
    """A change to a world; see ``do`` of a posterior."""

    world: World
    # site -> value, for stated goals, strengths and alpha; helpers follow
    sites: Mapping[str, Any]
    goals: Mapping[str, int]  # site of a goal -> effective goal, of that agent alone
    removed: tuple[int, ...]  # entities that are there no more
    walls: Any  # others; None: as they are
    words: str  # all of this

    @property
    def is_removal(self) -> bool:
        """Whether entities are removed and nothing else is changed."""
        return bool(self.removed) and not self.sites and not self.goals and self.walls is None

    @classmethod
    def of(
        cls,
        world: World,
        given: Mapping[str, Any],
        alpha: tuple[int, int] | None = None,
        relation: Mapping[tuple[str, str], str] | None = None,
        remove: str | Sequence[str] = (),
        walls: Any = None,
    ) -> Change:
        """Return the change given by names; arguments and errors as of ``do``."""
        space, words = space_of(world), []
        sites: dict[str, Any] = {}
        goals: dict[str, int] = {}
        for name, value in given.items():
            stated = name.removeprefix("stated_")
            if value is None:
                continue
            if name in space.strength_sites:
                sites[name] = checked_strength(name, value)
                words.append(f"{name} = {value}")
            elif stated in space.goal_sites:
                goal = goal_index(value, world)
                if space.impossible[space.goal_sites.index(stated), goal]:
                    raise InvalidSettingError(
                        f"{name}={world.goals[goal]!r} names the agent itself"
                    )
                (goals if name == stated else sites)[stated] = goal
                words.append(f"{name} = {world.goals[goal]}")
            else:
                known = (*space.goal_sites, *space.stated_sites, *space.strength_sites)
                raise unknown_name("quantity to change", name, known)
        if relation is not None:
            towards = towards_whom(relation, world)
            if tuple(towards) not in space.ways:
                raise InvalidSettingError(
                    f"relation={shown(dict(relation))}: whom one helps or hinders must be another "
                    "agent that pursues a goal of its own"
                )
            sites[ALPHA_SITE] = space.ways.index(tuple(towards))
            said = [f"the {who} {word}s the {whom}" for (who, whom), word in relation.items()]
            words.append(" and ".join(said) or "nobody helping or hindering")
        if alpha is not None:
            allowed = list(ALPHAS) if space.scenario_names else []
            if tuple(alpha) not in allowed:
                where = allowed or f"relation= in the world {world.name}"
                raise InvalidSettingError(f"alpha={shown(alpha)}, expected {where}")
            sites[ALPHA_SITE] = ALPHAS.index(tuple(alpha))
            words.append(f"alpha = {alpha}")
        instance_of("remove", remove, Iterable, "an entity or several")
        names = [remove] if isinstance(remove, str) else remove
        removed = tuple(_entity(name, world.entities) for name in names)
        words += [f"the {world.entities[entity]} removed" for entity in removed]
        words += [] if walls is None else ["other walls"]
        return cls(world, sites, goals, removed, walls, ", ".join(words))

    def hypothesis(self, sites: Mapping[str, Any]) -> Hypothesis:
        """Return a hypothesis, given by its sites, with the change: stated first, then effective.

        Raises:
            InvalidSettingError: an agent cannot help or hinder the other's new goal.
        """
        space, sites = space_of(self.world), {**sites, **self.sites}
        codes = {name: np.array([sites[name]]) for name in space.limits}
        effective = space.effective(codes)[0].tolist()
        if min(effective) < 0:
            agent = next(agent for agent, goal in enumerate(effective) if goal < 0)
            owner = int(space.owner[int(sites[ALPHA_SITE]), agent])
            agents, goals = self.world.agents, self.world.goals
            raise InvalidSettingError(
                f"the {agents[agent]} can do nothing for or against what the {agents[owner]} "
                f"would want: {goals[int(sites[space.goal_sites[owner]])]!r}"
            )
        own = dict(zip(space.goal_sites, effective, strict=True))
        nobody = space.ways.index((None,) * space.n_agents)
        return space.hypothesis({**sites, **own, **self.goals, ALPHA_SITE: nobody})


def simulated(
    post: Any,
    own_goals: FloatArray | None,
    change: Change,
    at: int | None,
    seconds: float | None,
    n: int,
    seed: int,
    workers: int | None,
    simulator: Simulator | None = None,
) -> WhatIf:
    """Return simulations, from a frame on, of hypotheses drawn from a posterior.

    A change is simulated in a second world; all else is as of ``do``. In other worlds than PHASE
    ``own_goals`` (agent, goal) is the prior of agents' own goals.
    """
    observed, scene, settings = post.observed(), post.scene, post.settings
    at, frames = _length(len(observed) - 1, at, seconds)
    whole_number("n", n, _FEWEST)
    model = settings.get("model", {})
    of_run = model.get("simulator", "joint")
    joint = of_run == "joint" if simulator is None else isinstance(simulator, JointSimulator)
    if not joint and (at or change.removed):
        raise InvalidSettingError(
            f"a frame to go on from and entities to remove need the joint simulator, not {of_run}: "
            "another one always begins at the start, with all entities"
        )
    if simulator is None:
        if not joint:
            raise InvalidSettingError(
                f"the run had a simulator of its own, {of_run}: give it, simulator=..."
            )
        stored = model.get("planner")
        simulator = JointSimulator("fast" if stored is None else PlannerConfig.from_dict(stored))
    drawn, space = _drawn(post, own_goals, n, seed), space_of(scene.world)
    hypotheses = [space.hypothesis(sites) for sites in drawn]
    worlds: list[tuple[Scene, tuple[int, ...], list[Any]]] = [(scene, (), hypotheses)]
    if change.words:
        walls = {} if change.walls is None else {"walls": change.walls}
        changed = [change.hypothesis(sites) for sites in drawn]
        worlds.append((dataclasses.replace(scene, **walls), change.removed, changed))
    followed = settings.get("likelihood", {}).get("tracking")  # of the closed loop
    tracking = None if followed is None else Tracking(**followed)
    past = reconstructed(scene, observed[: at + 1], tracking) if at else None
    seeds = np.random.SeedSequence([seed, n]).generate_state(n).tolist()
    tasks = [
        (simulator, where, h, int(one), frames, past, gone)
        for where, gone, rows in worlds
        for h, one in zip(rows, seeds, strict=True)
    ]
    poses = np.array(list(mapped(_simulate, tasks, number_of_workers(workers), "simulation")))
    if at:  # a frame is the mean over a step, a state its end: show what was seen
        there = (poses[:, 0, :, 0] > AWAY / 2) & ~np.isnan(observed[at]).any(axis=1)
        poses[:, 0][there] = np.broadcast_to(observed[at], poses[:, 0].shape)[there]
    return WhatIf(
        post.event_id,
        change.words,
        at,
        tuple(where for where, _, _ in worlds),
        [h.effective_goals for h in hypotheses],
        poses.reshape(len(worlds), n, *poses.shape[1:]),
        change.removed,
        change.is_removal,
    )


def _drawn(post: Any, own_goals: FloatArray | None, n: int, seed: int) -> list[dict[str, Any]]:
    """Return the sites of hypotheses, each by its weight to within one (systematic)."""
    table, space, rng = post.table, space_of(post.world), np.random.default_rng(seed)
    weights, values = np.cumsum(table.weights), table.values
    places = (rng.random() + np.arange(n)) / n
    rows = np.minimum(np.searchsorted(weights, places * weights[-1], "right"), len(weights) - 1)
    if ALPHA_SITE in values:
        ways = values[ALPHA_SITE][rows]
    else:  # a closed loop of another world keeps it agent by agent
        codes = space.alpha_codes(np.arange(len(space.ways)))
        way_of = {tuple(c[w] for c in codes.values()): w for w in range(len(space.ways))}
        ways = np.array([way_of[tuple(values[name][row] for name in codes)] for row in rows])
    columns = {ALPHA_SITE: ways}
    for site, name in zip(space.goal_sites, space.stated_sites, strict=True):
        # an agent that pursues its own goal acts on it
        columns[site] = values[name if name in values else site][rows]
    if own_goals is not None:  # own goals of helpers and hinderers have the prior's distribution
        for agent, (site, masses) in enumerate(zip(space.goal_sites, own_goals, strict=True)):
            idle = space.owner[ways, agent] != agent
            columns[site][idle] = rng.choice(len(masses), idle.sum(), p=masses / masses.sum())
    columns |= {name: values[name][rows] for name in space.strength_sites}
    return pd.DataFrame(columns).to_dict("records")


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


def _length(last: int, at: int | None, seconds: float | None) -> tuple[int, int]:
    """Return the first frame, and how many frames to simulate from there, that one included."""
    begin = 0 if at is None else at
    if isinstance(begin, bool) or not isinstance(begin, int) or not 0 <= begin <= last:
        raise InvalidSettingError(f"at={shown(at)}, expected a frame in 0..{last}")
    if seconds is not None:
        positive_number("seconds", seconds)
        return begin, max(1, round(seconds * FRAMES_PER_SECOND)) + 1
    if begin == last:
        raise InvalidSettingError(f"at={begin} is the last frame: say for how many seconds=")
    return begin, last - begin + 1
