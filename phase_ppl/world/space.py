"""Which hypotheses there are in a world: the sites of a prior, and what they come to.

A hypothesis is a goal of each agent, a way in which agents stand to each other, and strengths. It
has a site for each: ``goal_<agent>``, ``alpha`` and ``strength_<agent>``. Priors, kernels, the
bridge to the simulator, files and posteriors take names, codes and effective goals from here.
"""

from __future__ import annotations

import contextlib
import functools
import itertools
from collections.abc import Mapping
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from phase_ppl.world.arrays import FloatArray
from phase_ppl.world.errors import UnknownNameError
from phase_ppl.world.goals import effective_goal, is_self_referring, possible_goals
from phase_ppl.world.hypothesis import (
    ALPHAS,
    MOST_STRENGTH,
    RELATION_OF_SCENARIO,
    RELATIONS,
    Hypothesis,
    all_ways,
    scenario,
)
from phase_ppl.world.scene import PHASE, World

ALPHA_SITE: Final = "alpha"
"""Site of the way in which agents stand to each other: an index into ``ways``."""

MOST_LISTED: Final = 20_000  # stated goals with ways, of which a prior can be a table


class HypothesisSpace:
    """The hypotheses of a world; :func:`space_of` makes it.

    Attributes:
        world: whose agents and goals.
        n_agents, n_goals: numbers of its agents and goals.
        ways: in which agents can stand to each other, by code; each as :attr:`Hypothesis.towards`.
        goal_sites: names of the sites of stated goals; in files and posteriors, of effective ones.
        stated_sites: names of stated goals in files and posteriors.
        strength_sites: names of the sites of strengths, newtons.
        sites: names of all sites of a hypothesis.
        kept_columns: columns of ``sites`` as files name them: stated goals, way, strengths.
        columns: those of files: effective goals, which follow, and ``kept_columns``.
        relation_names: names of the quantities that say how two agents stand to each other -> the
            two, in order.
        alpha_names: names of those that say what one agent does to another -> the two, in order;
            none in PHASE, whose site ``alpha`` says it.
        scenario_names: names of those that say it in the paper's four scenarios.
        limits: site -> number of its codes; of goals and alpha.
    """

    def __init__(self, world: World) -> None:
        self.world = world
        self.n_agents, self.n_goals = len(world.agents), len(world.goals)
        self.ways = all_ways(self.n_agents)
        self.scenario_names: tuple[str, ...] = ()
        self.relation_names = {
            f"relation_{world.keys[one]}_{world.keys[other]}": (one, other)
            for one, other in itertools.combinations(range(self.n_agents), 2)
        }
        self.alpha_names = {
            f"alpha_{world.keys[who]}_{world.keys[whom]}": (who, whom)
            for who, whom in itertools.permutations(range(self.n_agents), 2)
        }
        if world == PHASE:
            self.ways = tuple(
                tuple((1 - agent, sign) if sign else None for agent, sign in enumerate(alpha))
                for alpha in ALPHAS
            )
            self.scenario_names = ("scenario",)
            self.relation_names, self.alpha_names = {"relation": (0, 1)}, {}
        self.goal_sites = tuple(f"goal_{key}" for key in world.keys)
        self.stated_sites = tuple(f"stated_{name}" for name in self.goal_sites)
        self.strength_sites = tuple(f"strength_{key}" for key in world.keys)
        self.sites = (*self.goal_sites, ALPHA_SITE, *self.strength_sites)
        self.kept_columns = (*self.stated_sites, ALPHA_SITE, *self.strength_sites)
        self.columns = (*self.goal_sites, *self.kept_columns)
        self.limits = dict.fromkeys(self.goal_sites, self.n_goals)
        self.limits[ALPHA_SITE] = len(self.ways)

    @property
    def is_listed(self) -> bool:
        """Whether a prior can be a table of all stated hypotheses, with all levels of strength."""
        few = self.n_goals**self.n_agents * len(self.ways) <= MOST_LISTED
        return few and self.n_agents <= 2  # of more not all strengths are followed

    @functools.cached_property
    def reserved(self) -> frozenset[str]:
        """Names that further sites of a prior cannot have."""
        alphas = self.alpha_names
        relations = (name.replace("alpha", "relation", 1) for name in alphas)
        return frozenset((*alphas, *relations, *self.columns))

    @functools.cached_property
    def impossible(self) -> NDArray[np.bool_]:
        """(agent, goal) goals that an agent cannot have, which have no prior mass."""
        return np.array(
            [
                [is_self_referring(goal, agent, self.world) for goal in range(self.n_goals)]
                for agent in range(self.n_agents)
            ]
        )

    @functools.cached_property
    def owner(self) -> NDArray[np.int32]:
        """(way, agent) the agent on whose stated goal an agent acts: mostly itself."""
        return np.array(
            [[a if one is None else one[0] for a, one in enumerate(way)] for way in self.ways],
            np.int32,
        )

    @functools.cached_property
    def becomes(self) -> NDArray[np.int32]:
        """(way, agent, goal) what a stated goal of the owner's is for an agent; -1: nothing."""
        found: dict[tuple[int, tuple[int, int] | None], NDArray[np.int32]] = {}
        for agent, towards in {pair for way in self.ways for pair in enumerate(way)}:
            owner = agent if towards is None else towards[0]
            row = np.full(self.n_goals, -1, np.int32)
            for goal in np.flatnonzero(~self.impossible[owner]).tolist():
                with contextlib.suppress(UnknownNameError):  # of what nobody could have as a goal
                    row[goal] = effective_goal([goal] * self.n_agents, agent, towards, self.world)
            found[agent, towards] = row
        return np.array([[found[pair] for pair in enumerate(way)] for way in self.ways])

    def effective(self, sites: Mapping[str, NDArray[Any]]) -> NDArray[np.int32]:
        """Return (row, agent) effective goals of columns of sites, each (row,)."""
        way = np.asarray(sites[ALPHA_SITE])
        stated = np.stack([np.asarray(sites[name]) for name in self.goal_sites], axis=-1)
        owner = self.owner[way]
        return self.becomes[
            way[..., None], np.arange(self.n_agents), np.take_along_axis(stated, owner, axis=-1)
        ]

    def in_support(self, sites: Mapping[str, NDArray[Any]]) -> NDArray[np.bool_]:
        """Return which rows of columns of sites are hypotheses at all.

        All have goals that they can have, and something to do where they help or hinder.
        """
        inside = np.ones(np.shape(sites[ALPHA_SITE]), bool)
        for agent, name in enumerate(self.goal_sites):
            codes = sites[name]
            in_range = (codes >= 0) & (codes < self.n_goals)
            inside &= in_range & ~self.impossible[agent][np.where(in_range, codes, 0)]
        way = sites[ALPHA_SITE]
        inside &= (way >= 0) & (way < len(self.ways))
        readable = {name: np.where(inside, sites[name], 0) for name in self.limits}
        inside &= (self.effective(readable) >= 0).all(axis=-1)
        for name in self.strength_sites:
            inside &= (sites[name] > 0) & (sites[name] <= MOST_STRENGTH)
        return inside

    def hypothesis(self, sites: Mapping[str, Any]) -> Hypothesis:
        """Return what values of the sites stand for, as simulators take it."""
        goals = tuple(int(sites[name]) for name in self.goal_sites)
        strengths = tuple(float(sites[name]) for name in self.strength_sites)
        return Hypothesis.coded(self.world, goals, self.ways[int(sites[ALPHA_SITE])], strengths)

    @functools.cached_property
    def relations(self) -> dict[tuple[int, int], NDArray[np.int64]]:
        """Two agents -> (goal, goal) codes, of ``RELATIONS``, of the relation between them."""
        found = {}
        for pair in itertools.combinations(range(self.n_agents), 2):
            table = np.full((self.n_goals, self.n_goals), RELATIONS.index("neutral"))
            for one, other in itertools.product(*(possible_goals(a, self.world) for a in pair)):
                name = RELATION_OF_SCENARIO[scenario(one, other, self.world, pair)]
                table[one, other] = RELATIONS.index(name)
            found[pair] = table
        return found

    def relation_codes(self, goals: NDArray[Any]) -> dict[str, NDArray[np.int64]]:
        """Return the relations, by name, of (..., agent) effective goals."""
        return {
            name: self.relations[one, other][goals[..., one], goals[..., other]]
            for name, (one, other) in self.relation_names.items()
        }

    def alpha_codes(self, way: NDArray[Any]) -> dict[str, NDArray[np.int64]]:
        """Return ``alpha_<who>_<whom>`` of ways, beside PHASE: 2 helps, 0 hinders, 1 neither."""
        found = {}
        for name, (who, whom) in self.alpha_names.items():
            towards = [one[who] or (who, 0) for one in self.ways]
            signs = np.array([sign if other == whom else 0 for other, sign in towards])
            found[name] = signs[way] + 1
        return found

    def log_prior_of_effective(
        self, log_goals: FloatArray, log_alpha: FloatArray, goals: NDArray[Any]
    ) -> FloatArray:
        """Return (way, row) log masses of effective goals (row, agent) together with each way.

        Stated goals, (agent, goal) log masses, and ways, (way,), are independent of each other.
        """
        goals = np.asarray(goals, np.int64)
        found = np.empty((len(self.ways), len(goals)))
        for way, towards in enumerate(self.ways):
            found[way] = log_alpha[way]
            for agent, one in enumerate(towards):
                if one is None:
                    found[way] += log_goals[agent][goals[:, agent]]
                else:
                    follows = self.becomes[way, agent][goals[:, one[0]]] == goals[:, agent]
                    found[way][~follows] = -np.inf
        return found

    def possible_share(self, log_goals: FloatArray, log_alpha: FloatArray) -> float:
        """Return the prior mass of hypotheses in which whoever helps or hinders can act.

        Masses as of :meth:`log_prior_of_effective`. The others have no part in a posterior.
        """
        shares, total = np.exp(log_goals), 0.0
        for way, share in enumerate(np.exp(log_alpha)):
            for owner in np.unique(self.owner[way]):
                follow = self.becomes[way][self.owner[way] == owner]
                share *= shares[owner][(follow >= 0).all(axis=0)].sum()
            total += share
        return float(total)


@functools.lru_cache(16)
def space_of(world: World) -> HypothesisSpace:
    """Return the hypotheses of a world."""
    return HypothesisSpace(world)
