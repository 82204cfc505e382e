"""Independent sets of beliefs and searches that go along with a video."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from typing import Any, NamedTuple

import numpy as np

from phase_ppl.agents.agent import Policies, RootStatistics
from phase_ppl.agents.config import PlannerConfig
from phase_ppl.agents.world_model import WorldModel
from phase_ppl.closed_loop.hidden_state import Expected, HiddenState, Tracking
from phase_ppl.physics.actions import N_ACTIONS, Action
from phase_ppl.world.arrays import BoolArray, FloatArray, IntArray
from phase_ppl.world.scene import Scene


class Looked(NamedTuple):
    """One agent's plans at one moment, by one set of beliefs and searches."""

    roots: list[RootStatistics]  # of every intent, what its search found
    # (standpoint,) index of the intent, or ``NO_INTENT``: of a pair of goals in PHASE, in other
    # company as ``agents.standpoints`` numbers them
    intent_of: IntArray


class Conduct(NamedTuple):
    """How agents act on their plans."""

    sharpness: float  # exponent of a search's root visits
    lapse: float  # probability, by frame, that an agent does anything whatever

    def policy(self, root: RootStatistics) -> FloatArray:
        """Return (action,) probabilities of an agent, from what its search found.

        pi = (1 - lapse) visits^sharpness / Z + lapse / |A|
        """
        found = np.full(N_ACTIONS, self.lapse / N_ACTIONS)
        share = (root.visits / root.visits.max()) ** self.sharpness
        found[root.actions] += (1.0 - self.lapse) * share / share.sum()
        return found


class SearchSets:
    """Every agent's policies, in several independent sets, at what was seen.

    Args:
        scene: where everything starts, at rest.
        planner: settings of the agents' planner.
        tracking: settings of the filter of hidden states.
        seed: of beliefs and searches.
        threads: at most so many at a time; the result does not depend on it.
        n: sets. Each plans with strengths of its own, which together stand for what is believed of
            them.

    Attributes:
        scene: where everything starts.
        hidden: velocities, holds and strengths; whoever reads frames takes them there.
    """

    def __init__(
        self,
        scene: Scene,
        planner: PlannerConfig,
        tracking: Tracking,
        seed: int = 0,
        threads: int = 1,
        n: int = 1,
    ) -> None:
        self.scene, self._planner = scene, planner
        self.hidden = HiddenState(scene, tracking, threads)
        self._models: dict[tuple[float, ...], WorldModel] = {}
        self._policies = [
            [
                Policies(agent, self._model(expected.strengths), planner, _seed(seed, place))
                for agent in range(len(scene.world.agents))
            ]
            for place, expected in enumerate(self.hidden.spread(n))
        ]
        self._pool = ThreadPoolExecutor(threads) if threads > 1 else None

    def __len__(self) -> int:
        return len(self._policies)

    def close(self) -> None:
        """End the threads."""
        if self._pool is not None:
            self._pool.shutdown(cancel_futures=True)

    def map(self, function: Callable[..., Any], tasks: Iterable[Any]) -> Iterator[Any]:
        """Return the function's results, in order, from the threads if there are any."""
        return map(function, tasks) if self._pool is None else self._pool.map(function, tasks)

    def look(self, wanted: Sequence[BoolArray] | None = None) -> list[list[Looked]]:
        """Return (set, agent) what the planners make of what was seen so far.

        Args:
            wanted: (agent) (standpoint,) those for which all sets search; for the rest there is
                the first set alone. None: all sets search for all.
        """

        def observe(task: tuple[Policies, Expected, BoolArray | None]) -> None:
            policies, expected, asked = task
            policies.observe(expected.bodies, expected.held, expected.weld, asked)

        observing = []
        for place, expected in enumerate(self.hidden.spread(len(self._policies))):
            for agent, policies in enumerate(self._policies[place]):
                policies.model = self._model(expected.strengths)
                asked = None if wanted is None or place == 0 else wanted[agent]
                observing.append((policies, expected, asked))
        list(self.map(observe, observing))
        searches = [(one, group) for one, _, _ in observing for group in one.searches()]
        found = {
            (one, place): root
            for (one, group), roots in zip(searches, self.map(_search, searches), strict=True)
            for place, root in zip(group, roots, strict=True)
        }
        return [
            [
                Looked([found[one, k] for k in range(len(one.intents))], one.intent_of.copy())
                for one in each
            ]
            for each in self._policies
        ]

    def done(self, actions: Sequence[Action]) -> None:
        """Say what the agents have just done, from which their beliefs go on."""
        for each in self._policies:
            for policies, action in zip(each, actions, strict=True):
                policies.done(action)

    def _model(self, strengths: tuple[float, ...]) -> WorldModel:
        if strengths not in self._models:
            self._models[strengths] = WorldModel.of(self.scene, strengths, self._planner)
        return self._models[strengths]


def _search(task: tuple[Policies, list[int]]) -> list[RootStatistics]:
    policies, group = task
    return policies.root_statistics([policies.intents[place] for place in group])


def _seed(seed: int, place: int) -> int:
    """Return the seed of one of several sets of searches; the first has the seed itself."""
    if place == 0:
        return seed
    return int(np.random.SeedSequence([seed, place]).generate_state(1, np.uint64)[0])
