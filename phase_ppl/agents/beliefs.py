"""Belief particles: possible world states consistent with what an agent has observed.

Source: paper, Appendix "Belief Representation and Update": K particles. Each step predicts them
with the physics, overwrites what is observed, and resamples what contradicts the observation. We
add that a hand that closed on nothing is an observation: no item was in reach.
"""

from __future__ import annotations

import math
from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from phase_ppl.agents import vision
from phase_ppl.agents.config import PlannerConfig
from phase_ppl.agents.pomcp import below, make_rng
from phase_ppl.agents.vision import MAX_OUTLINE_CELLS, OUTSIDE, outline_cells, shapes_meet
from phase_ppl.agents.world_model import Layout, WorldModel
from phase_ppl.physics import compiled
from phase_ppl.physics.actions import NO_ACTION, Action
from phase_ppl.physics.compiled import Params, Scratch
from phase_ppl.physics.jit import bare_kernel
from phase_ppl.physics.records import record
from phase_ppl.physics.welds import in_reach
from phase_ppl.world.arrays import BoolArray, FloatArray, IntArray
from phase_ppl.world.event import State
from phase_ppl.world.names import NOTHING

OBSERVED_ENLARGEMENT: Final = 1.1
"""An unobserved entity must not overlap an observed shape enlarged this much."""

POSITION_TOLERANCE: Final = 1.0
"""In view, a particle's entity must lie within this of the truth in x and y, units."""

START_INSET: Final = 2.0
"""Initial positions are integer points at least this far from the border, units."""

N_HEADINGS: Final = 8
DRAWS_WITHOUT_OVERLAP: Final = 10
DRAWS_IN_ALL: Final = 20

_ATTACH = int(Action.ATTACH)


@record
class Beliefs(NamedTuple):
    """The belief of one agent."""

    bodies: FloatArray  # (K, entity, 9) physical states, as in ``physics.flat``
    held: IntArray  # (K, agent) held items
    weld: FloatArray  # (K, agent, 3) how they are held
    ever_seen: BoolArray  # (cells,) cells that have ever been in view
    visible: BoolArray  # (cells,) cells in view now
    observed: BoolArray  # (entity,) entities observed now
    actions: IntArray  # (agent,) the agents' actions in a prediction
    cells: IntArray  # scratch
    open_cells: IntArray


@bare_kernel
def _consistent(
    bodies: FloatArray,
    entity: int,
    truth: FloatArray,
    missed_by: int,
    beliefs: Beliefs,
    params: Params,
    layout: Layout,
) -> bool:
    """Whether a particle's unobserved entity agrees with what the agent sees and feels.

    Args:
        missed_by: the agent, if it has just tried to grab and holds nothing; else NOTHING.
    """
    is_item = entity >= params.force.shape[0]
    if is_item and missed_by >= 0 and in_reach(bodies, missed_by, entity, params):
        return False
    n = outline_cells(bodies, entity, params, layout, beliefs.cells)
    off = (
        abs(bodies[entity, 0] - truth[entity, 0]) > POSITION_TOLERANCE
        or abs(bodies[entity, 1] - truth[entity, 1]) > POSITION_TOLERANCE
    )
    for i in range(n):
        if beliefs.cells[i] == OUTSIDE:
            return False
        if off and beliefs.visible[beliefs.cells[i]]:
            return False
    for other in range(bodies.shape[0]):
        if beliefs.observed[other] and shapes_meet(
            bodies, entity, other, 1.0, OBSERVED_ENLARGEMENT, params
        ):
            return False
    return True


@bare_kernel
def _overlaps(bodies: FloatArray, entity: int, settled: int, params: Params) -> bool:
    for other in range(bodies.shape[0]):
        if (settled >> other) & 1 and shapes_meet(bodies, entity, other, 1.0, 1.0, params):
            return True
    return False


@bare_kernel
def _resample(
    bodies: FloatArray,
    entity: int,
    settled: int,
    n_open: int,
    truth: FloatArray,
    missed_by: int,
    beliefs: Beliefs,
    params: Params,
    layout: Layout,
    rng: NDArray[np.uint64],
) -> None:
    """Draw a new place for ``entity`` among the open cells, at rest and holding nothing.

    Up to 10 draws must be consistent and free of overlap, 10 more only consistent; else the last
    draw stands.
    """
    for column in range(bodies.shape[1]):
        bodies[entity, column] = 0.0
    for draw in range(DRAWS_IN_ALL):
        cell = beliefs.open_cells[below(rng, n_open)]
        for turn in range(N_HEADINGS):
            angle = 2.0 * math.pi * turn / N_HEADINGS
            bodies[entity, 2] = angle
            # the body origin goes to the drawn corner
            cog = params.cog[entity]
            bodies[entity, 0] = layout.origin[0] + cell % layout.columns - math.sin(angle) * cog
            bodies[entity, 1] = layout.origin[1] - cell // layout.columns + math.cos(angle) * cog
            if _consistent(bodies, entity, truth, missed_by, beliefs, params, layout) and (
                draw >= DRAWS_WITHOUT_OVERLAP or not _overlaps(bodies, entity, settled, params)
            ):
                return
            if entity >= params.force.shape[0]:
                break


@bare_kernel
def _list_open_cells(beliefs: Beliefs) -> int:
    """List the cells never seen; if none, those not in view; else all. Return their number."""
    for excluded in (beliefs.ever_seen, beliefs.visible):
        n = 0
        for cell in range(excluded.shape[0]):
            if not excluded[cell]:
                beliefs.open_cells[n] = cell
                n += 1
        if n > 0:
            return n
    for cell in range(beliefs.visible.shape[0]):
        beliefs.open_cells[cell] = cell
    return beliefs.visible.shape[0]


@bare_kernel
def update(
    beliefs: Beliefs,
    truth: FloatArray,
    truth_held: IntArray,
    truth_weld: FloatArray,
    agent: int,
    own_action: int,
    predict: bool,
    params: Params,
    layout: Layout,
    scratch: Scratch,
    rng: NDArray[np.uint64],
) -> None:
    """Update all particles in place.

    Args:
        beliefs: its ``visible`` and ``observed`` must already be of this step.
        truth, truth_held, truth_weld: true state; only observed entities are read.
        agent: whose beliefs.
        own_action: the agent's last action; other agents are taken to coast.
        predict: whether to simulate one step first (not before the first action).
    """
    n_bodies, n_agents = truth.shape[0], truth_held.shape[0]
    for cell in range(beliefs.visible.shape[0]):
        if beliefs.visible[cell]:
            beliefs.ever_seen[cell] = True
    n_open = _list_open_cells(beliefs)
    beliefs.actions[agent] = own_action
    grabbed_nothing = predict and own_action == _ATTACH and truth_held[agent] < 0
    missed_by = agent if grabbed_nothing else NOTHING
    all_observed = True
    for entity in range(n_bodies):
        all_observed = all_observed and beliefs.observed[entity]
    for k in range(beliefs.bodies.shape[0]):
        bodies, held, weld = beliefs.bodies[k], beliefs.held[k], beliefs.weld[k]
        if predict and not all_observed:
            compiled.step(bodies, held, weld, beliefs.actions, params, scratch)
        settled = 0
        for entity in range(n_bodies):
            if not beliefs.observed[entity]:
                continue
            settled |= 1 << entity
            for column in range(bodies.shape[1]):
                bodies[entity, column] = truth[entity, column]
            if entity < n_agents:
                held[entity] = truth_held[entity]
                for column in range(weld.shape[1]):
                    weld[entity, column] = truth_weld[entity, column]
        for other in range(n_agents):
            if not beliefs.observed[other] and held[other] >= 0 and beliefs.observed[held[other]]:
                held[other] = NOTHING
        # what agrees is kept first, so that moved entities can avoid it
        moved = 0
        for entity in range(n_bodies):
            if beliefs.observed[entity]:
                continue
            if _consistent(bodies, entity, truth, missed_by, beliefs, params, layout):
                settled |= 1 << entity
            else:
                moved |= 1 << entity
        for other in range(n_agents):
            if held[other] >= 0 and ((moved >> other) & 1 or (moved >> held[other]) & 1):
                held[other] = NOTHING
        for entity in range(n_bodies):
            if (moved >> entity) & 1:
                _resample(
                    bodies, entity, settled, n_open, truth, missed_by, beliefs, params, layout, rng
                )
                settled |= 1 << entity


def _closed_off(model: WorldModel, own: FloatArray) -> BoolArray | None:
    """Return (cells,) cells outside the floor plan, as beside an L-shaped flat; None: no such cell.

    No way leads there from the agent or from a landmark.
    """
    rooms, layout = model.scene.rooms, model.layout
    closed = rooms.closed_off([own, *layout.landmarks])
    if not closed:
        return None
    column, row = np.meshgrid(np.arange(layout.columns), np.arange(layout.rows))
    found = np.ones(layout.rows * layout.columns, np.bool_)
    for across, down in ((0.01, 0.01), (0.01, 0.99), (0.99, 0.01), (0.99, 0.99)):
        x, y = layout.origin[0] + column + across, layout.origin[1] - row - down
        found &= np.isin(rooms.room_of(np.stack([x, y], axis=-1)), closed).ravel()
    return found


class Perception:
    """The belief particles of one agent, updated by what it sees; they do not depend on its goal.

    Args:
        agent: which one.
        model: layout and imagined physics; may be exchanged between observations.
        config: settings of the planner.
        generator: source of all randomness of this agent.

    Attributes:
        beliefs: the particles.
        rng: the agent's random numbers, for compiled code.
        scratch: work space.
    """

    def __init__(
        self, agent: int, model: WorldModel, config: PlannerConfig, generator: np.random.Generator
    ) -> None:
        self.agent, self.model, self.config = agent, model, config
        self.rng = make_rng(generator)
        layout, n = model.layout, config.particles
        truth, held, weld = compiled.from_state(State.at_start(model.scene), model.scene.radius)
        # the others' centres of mass lie uniformly on integer points, at rest
        bodies = np.zeros((n, *truth.shape))
        x_points = np.arange(layout.origin[0] + START_INSET, layout.origin[0] + layout.columns - 1)
        y_points = np.arange(layout.origin[1] - layout.rows + START_INSET, layout.origin[1] - 1)
        bodies[..., 0] = generator.choice(x_points, size=bodies.shape[:2])
        bodies[..., 1] = generator.choice(y_points, size=bodies.shape[:2])
        bodies[:, agent] = truth[agent]
        n_cells = layout.rows * layout.columns
        self.beliefs = Beliefs(
            bodies=bodies,
            held=np.tile(held, (n, 1)),
            weld=np.tile(weld, (n, 1, 1)),
            ever_seen=np.zeros(n_cells, np.bool_),
            visible=np.zeros(n_cells, np.bool_),
            observed=np.zeros(len(truth), np.bool_),
            actions=np.full(len(held), NO_ACTION, np.int64),
            cells=np.zeros(MAX_OUTLINE_CELLS, np.int64),
            open_cells=np.zeros(n_cells, np.int64),
        )
        self.scratch = compiled.make_scratch(len(truth), len(held))
        self._last_action: Action | None = None
        self._closed_off = _closed_off(model, truth[agent, :2])

    def acted(self, action: Action) -> None:
        """Note the agent's last action, from which the next prediction starts."""
        self._last_action = action

    def observe(self, bodies: FloatArray, held: IntArray, weld: FloatArray) -> None:
        """Observe the true state and update the belief particles.

        Args:
            bodies, held, weld: the true state, as from ``physics.compiled.from_state``.
        """
        model, beliefs = self.model, self.beliefs
        vision.observe(
            *(bodies, held, self.agent, self.config.full_observation, model.params, model.layout),
            *(beliefs.visible, beliefs.cells, beliefs.observed),
        )
        if self._closed_off is not None:  # nothing can be hidden there
            beliefs.visible[self._closed_off] = True
        if self.config.true_state:
            beliefs.bodies[:], beliefs.held[:], beliefs.weld[:] = bodies, held, weld
            return
        predict = self._last_action is not None
        own_action = int(Action.NO_FORCE if self._last_action is None else self._last_action)
        update(
            *(beliefs, bodies, held, weld, self.agent, own_action, predict),
            *(model.params, model.layout, self.scratch, self.rng),
        )
