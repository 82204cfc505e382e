"""Events to train the network of strengths on, simulated in drawn scenes.

The scenes have the layouts, sizes and start positions of PHASE. Goals and relations are drawn so
that the agents mostly have something to do; PHASE's own families of events are narrower.
"""

from __future__ import annotations

import functools
import json
from pathlib import Path
from typing import Any, Final, NamedTuple

import loky
import numpy as np
from numpy.typing import NDArray
from tqdm import tqdm

from phase_ppl.dataset.generation.tables import LAYOUTS, SIZES, SPOTS, walls_of
from phase_ppl.simulator.joint import JointSimulator
from phase_ppl.simulator.simulate import simulate
from phase_ppl.world.arrays import FloatArray
from phase_ppl.world.errors import InvalidSettingError
from phase_ppl.world.goals import goal_literal, literal_goal
from phase_ppl.world.hypothesis import ALPHAS, STRENGTH_LEVELS, STRENGTH_RANGE, Hypothesis
from phase_ppl.world.literals import Literal, Predicate
from phase_ppl.world.names import BLUE_ITEM, GREEN, LANDMARKS, PINK_ITEM, RED
from phase_ppl.world.scene import TURNINGS, Scene

SIZE_SHARES: Final = (0.55, 0.16, 0.11, 0.18)
"""How often PHASE's sizes are drawn: about as often as there."""

LEVEL_SHARE: Final = 0.5
"""Share of the strengths that are one of the original world's four levels; the rest is uniform
on the support of the prior."""

OWN_GOALS: Final = {"item": 0.65, "self": 0.2, "agents": 0.15}
"""What agents want for themselves, and how often: about as in PHASE."""

COMPANY: Final = {"same": 0.3, "rival": 0.15, "social": 0.25, "alone": 0.3}
"""The two goals: the same, the same item on another landmark, one agent helps or hinders, each
its own."""


class Simulated(NamedTuple):
    """Simulated events of equal length.

    Attributes:
        trajectory: (event, time, entity, coord) x, y [units], angle [rad].
        radius: (event, entity) sizes, units.
        strength: (event, agent) newtons.
    """

    trajectory: NDArray[np.float32]
    radius: FloatArray
    strength: FloatArray

    def part(self, first: int, last: int | None) -> Simulated:
        """Return the events from ``first`` to before ``last``, or to the end."""
        chosen = slice(first, last)
        return Simulated(self.trajectory[chosen], self.radius[chosen], self.strength[chosen])


def draw_scene(rng: np.random.Generator) -> Scene:
    """Return a scene with a layout, sizes and start positions of PHASE."""
    layout = list(LAYOUTS)[rng.integers(len(LAYOUTS))]
    places = np.reshape(SPOTS, (-1, 2)).astype(np.float64)
    spots = places[rng.choice(len(places), 4, replace=False)]
    angles = np.append(rng.uniform(-2 * np.pi, 2 * np.pi, 2), [0.0, 0.0])
    return Scene(
        start=np.column_stack([spots, angles]),
        radius=rng.choice(SIZES, 4, p=SIZE_SHARES),
        walls=walls_of(layout),
        turning=TURNINGS[rng.integers(len(TURNINGS))],
    )


def draw_hypothesis(rng: np.random.Generator) -> Hypothesis:
    """Return goals, relation and strengths."""
    first, second = _own_goal(rng, RED), _own_goal(rng, GREEN)
    alpha = (0, 0)
    company = rng.choice(list(COMPANY), p=list(COMPANY.values()))
    literal = goal_literal(first, RED)
    if company == "social":
        alpha = ALPHAS[rng.integers(1, len(ALPHAS))]
    elif company == "same" and literal.predicate is Predicate.ON:
        second = first
    elif company == "rival" and literal.predicate is Predicate.ON:
        others = [landmark for landmark in range(len(LANDMARKS)) if landmark != literal.target]
        second = literal_goal(literal._replace(target=int(rng.choice(others))))
    levels = rng.random(2) < LEVEL_SHARE
    strengths = np.where(levels, rng.choice(STRENGTH_LEVELS, 2), rng.uniform(*STRENGTH_RANGE, 2))
    return Hypothesis(first, second, alpha, *map(float, strengths))


def _own_goal(rng: np.random.Generator, holder: int) -> int:
    """Return an item or the agent itself on a landmark, or the agents together or apart."""
    kind = rng.choice(list(OWN_GOALS), p=list(OWN_GOALS.values()))
    if kind == "agents":
        return literal_goal(Literal(Predicate.TOUCH, holder, 1 - holder, bool(rng.random() < 0.5)))
    subject = int(rng.choice((BLUE_ITEM, PINK_ITEM))) if kind == "item" else holder
    return literal_goal(Literal(Predicate.ON, subject, int(rng.integers(len(LANDMARKS))), True))


def simulate_event(seed: int, frames: int, index: int) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return trajectory, sizes and strengths of one drawn event."""
    rng = np.random.default_rng([seed, index])
    scene, hypothesis = draw_scene(rng), draw_hypothesis(rng)
    event = simulate(scene, hypothesis, frames=frames, seed=int(rng.integers(2**31)))
    return event.observation.trajectory, scene.radius, np.array(hypothesis.strengths)


def simulate_events(n: int, frames: int, seed: int, workers: int = 1) -> Simulated:
    """Return ``n`` drawn events, the same for any number of workers."""
    JointSimulator().warm_up()
    one = functools.partial(simulate_event, seed, frames)
    if workers == 1:
        found = [one(index) for index in tqdm(range(n), desc="events", disable=None)]
    else:
        with loky.ProcessPoolExecutor(workers) as pool:
            running = pool.map(one, range(n))
            found = list(tqdm(running, total=n, desc="events", disable=None))
    trajectory, radius, strength = zip(*found, strict=True)
    return Simulated(np.array(trajectory, np.float32), np.array(radius), np.array(strength))


def cached_events(file: Path, n: int, frames: int, seed: int, workers: int = 1) -> Simulated:
    """Return drawn events, from a file if they are there, else simulated and written to it.

    Raises:
        InvalidSettingError: the file holds others.
    """
    wanted: dict[str, Any] = {"events": n, "frames": frames, "seed": seed}
    if file.exists():
        with np.load(file) as kept:
            found = json.loads(str(kept["settings"]))
            if found != wanted:
                raise InvalidSettingError(f"{file} holds events of {found}, not of {wanted}")
            return Simulated(*(kept[name] for name in Simulated._fields))
    events = simulate_events(n, frames, seed, workers)
    file.parent.mkdir(parents=True, exist_ok=True)
    np.savez_compressed(file, settings=json.dumps(wanted), **events._asdict())
    return events
