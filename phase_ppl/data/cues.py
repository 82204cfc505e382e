"""Surface cues of a video: what agents do, without any inference about goals.

A cue is a function ``cue(scene, observation, pair)`` that returns a number of a size of about 1.
``pair`` are the indices of two agents in ``scene.world.agents``, by default the first two. Cues are
evidence of a relation, not parts of a model of how videos come about: a prior that uses them looks
at the video, which the likelihood explains too.

A cue raises an InvalidEventError if a body was not seen in some frame. All except ``unsettled``,
which is about all bodies, raise an InvalidSettingError if the world has no such pair of agents.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Final

import numpy as np

from phase_ppl.data.motion import TAIL, items_held, last_motion
from phase_ppl.world.arrays import BoolArray, FloatArray
from phase_ppl.world.errors import InvalidSettingError, shown
from phase_ppl.world.event import Observation
from phase_ppl.world.names import NOTHING
from phase_ppl.world.scene import Scene

__all__ = [
    "CUES",
    "contact",
    "distance",
    "holding",
    "impact",
    "surface",
    "synchrony",
    "unsettled",
    "working",
]

Pair = tuple[int, int]

_REACH: Final = 1.5  # half the width of an agent's broad side, in its radii
_NEAR: Final = 5.0  # units, half the width of a room: the unit of distance and impact
_SIDE: Final = 1.2  # mean distance of an outline from the centre, in radii, a little generous
_AT: Final = 0.4  # units from an item within which an agent is at it
_MOVES: Final = 0.05  # units per frame from which on a body counts as moving
_WHAT: Final = "a cue"  # in errors


def distance(scene: Scene, observation: Observation, pair: Pair = (0, 1)) -> float:
    """Return log(d / 5 units) of the mean distance d between the two agents' centres."""
    return float(np.log(max(_apart(scene, observation, pair).mean(), 1e-3) / _NEAR))


def contact(scene: Scene, observation: Observation, pair: Pair = (0, 1)) -> float:
    """Return the share of frames in which the two agents are near enough to touch."""
    return float(_touch(scene, observation, pair).mean())


def working(scene: Scene, observation: Observation, pair: Pair = (0, 1)) -> float:
    """Return how much the two agents move the same item, from 0 to 1; 0 without items.

    For each item, it is the geometric mean, over the two agents, of the share of frames in which
    the item moves and the agent is at it. The largest value of all items counts.
    """
    trajectory, n = _seen(scene, observation, pair), len(scene.world.agents)
    agents, items = trajectory[:, pair, None, :2], trajectory[:, None, n:, :2]
    rims = _SIDE * scene.radius[[*pair], None] + scene.radius[n:]
    at = np.linalg.norm(agents - items, axis=-1) < rims + _AT
    shifted = np.linalg.norm(np.diff(items[:, 0], axis=0), axis=-1) > _MOVES
    handled = (at[1:] & shifted[:, None]).mean(axis=0)  # agent, item
    return float(np.sqrt(handled.prod(axis=0)).max(initial=0.0))


def impact(scene: Scene, observation: Observation, pair: Pair = (0, 1)) -> float:
    """Return how hard the two agents meet: by how far they approach before a contact, over 5 units.

    It is the largest approach within the three frames before a contact begins; 0 without contact.
    """
    apart, touch = _apart(scene, observation, pair), _touch(scene, observation, pair)
    begins = np.flatnonzero(touch[1:] & ~touch[:-1]).tolist()
    return float(max((apart[max(i - 2, 0)] - apart[i + 1] for i in begins), default=0.0)) / _NEAR


def holding(scene: Scene, observation: Observation, pair: Pair = (0, 1)) -> float:
    """Return 1 if the two agents hold the same item at some time, else 0."""
    n = len(scene.world.agents)
    one, other = items_held(_seen(scene, observation, pair), scene.radius, n_agents=n)[:, pair].T
    return float(((one != NOTHING) & (one == other)).any())


def unsettled(scene: Scene, observation: Observation, pair: Pair = (0, 1)) -> float:
    """Return 1 if a body still moves in the last five frames of the video, else 0."""
    last = last_motion(observation.whole(_WHAT).trajectory)
    return float(last > 0 and observation.n_frames - 1 - last < TAIL)


def synchrony(scene: Scene, observation: Observation, pair: Pair = (0, 1)) -> float:
    """Return the mean cosine of the angle between the two agents' motions, from -1 to 1.

    Frames in which an agent rests count 0.
    """
    steps = np.diff(_seen(scene, observation, pair)[:, pair, :2], axis=0)
    speeds = np.linalg.norm(steps, axis=2)
    cosine = steps.prod(axis=1).sum(axis=1) / np.maximum(speeds.prod(axis=1), _MOVES**2)
    return float(np.where((speeds > _MOVES).all(axis=1), cosine, 0.0).mean())


CUES: Final[dict[str, Callable[..., float]]] = {
    cue.__name__: cue for cue in (distance, contact, working, impact, holding, unsettled, synchrony)
}
"""Name -> cue."""


def surface(scene: Scene, observation: Observation, pair: Pair = (0, 1)) -> dict[str, float]:
    """Return name -> value of each cue of a video; ``pair`` are the indices of two agents."""
    return {name: cue(scene, observation, pair) for name, cue in CUES.items()}


def _seen(scene: Scene, observation: Observation, pair: Pair) -> FloatArray:
    """Return the trajectory, once it is known to show two agents throughout."""
    n = len(scene.world.agents)
    if len(pair) != 2 or len(set(pair) & set(range(n))) != 2:
        raise InvalidSettingError(
            f"pair={shown(pair)}, expected places of two of the world's agents, which are {n}"
        )
    return observation.whole(_WHAT).trajectory


def _apart(scene: Scene, observation: Observation, pair: Pair) -> FloatArray:
    """Return (time,) distances between two agents' centres, units."""
    one, other = _seen(scene, observation, pair)[:, pair, :2].transpose(1, 0, 2)
    return np.asarray(np.linalg.norm(one - other, axis=1))


def _touch(scene: Scene, observation: Observation, pair: Pair) -> BoolArray:
    """Return (time,) whether two agents' broad sides could touch."""
    return np.asarray(_apart(scene, observation, pair) < _REACH * scene.radius[[*pair]].sum())


def __dir__() -> list[str]:
    return __all__
