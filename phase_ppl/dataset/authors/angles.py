"""Angles of the authors' reflected copies, repaired.

In copies about a diagonal the angles were wrapped into (-2 pi, 0] in every substep and only then
averaged over the five substeps of a frame. A frame in which the angle passes the cut is therefore
off by a multiple of 2 pi / 5, beside the jump by 2 pi from then on.
"""

from __future__ import annotations

from typing import Final

import numpy as np
from numpy.typing import NDArray

from phase_ppl.dataset.turning import full_turn
from phase_ppl.physics.constants import SUBSTEPS

FloatArray = NDArray[np.float64]

TURN: Final = 2 * np.pi
_ROUNDING: Final = 1e-6
_MISFIT: Final = 4.0
"""How much worse it is to be a radian off the cut than to turn by a radian."""

_PASS: Final = 0.1
"""Cost of passing the cut, rad^2."""

_BACK: Final = 3.0
"""Cost of passing it forth and back within two frames, rad^2."""

_JUMPS: Final = np.array([0, -1, 1])
"""Cuts that may be passed between two frames; first what wins a tie."""

_PASSING: Final = np.array(
    [(0, 0)] + [(way, after) for way in (1, -1) for after in range(1, SUBSTEPS)]
)
"""(state, 2): the way in which the cut is passed within a frame (1 as the angle grows, 0 not at
all), and the number of substeps after that."""


def repaired(angles: FloatArray, radius: float) -> FloatArray:
    """Return an agent's angles as if they had been averaged before they were wrapped.

    Of all ways in which the angle may have passed the cut, the one that takes the least turning,
    where a frame that passes it must lie near it: as near as at most a full turn explains. Angles
    that lie beyond the cut anyway were never wrapped and stay as they are.

    Args:
        angles: (time,) means over the frames, rad.
        radius: size of the agent, which says how fast it turns.
    """
    if (angles > _ROUNDING).any() or (angles < -TURN - _ROUNDING).any():
        return angles
    way, after = _PASSING.T
    price = _price(way)
    share = TURN * way * after / SUBSTEPS
    # relative to the turns done before the frame, and after it
    before, later = angles[:, None] + share, angles[:, None] + share - TURN * way
    misfit = _misfit(before, radius)
    misfit[0, 1:] = np.inf  # the first frame is no mean
    cost = misfit[0]
    choices = []
    for frame in range(1, len(angles)):
        step = before[frame][:, None, None] + TURN * _JUMPS - later[frame - 1][:, None]
        # (state, former state, jump)
        total = cost[:, None] + step**2 + price
        flat = total.reshape(len(share), -1)
        best = flat.argmin(axis=1)
        choices.append(best)
        cost = flat[np.arange(len(share)), best] + misfit[frame]
    return _followed(before, way, choices, int(cost.argmin()))


def _price(way: NDArray[np.int64]) -> FloatArray:
    """Return (state, former state, jump) what passing the cut costs."""
    passes = np.stack(
        np.broadcast_arrays(way[:, None, None], way[None, :, None], _JUMPS[None, None, :])
    )
    back = (passes > 0).any(axis=0) & (passes < 0).any(axis=0)
    return _PASS * np.abs(passes[[0, 2]]).sum(axis=0) + _BACK * back


def _misfit(before: FloatArray, radius: float) -> FloatArray:
    """Return (time, state) how badly a frame would pass the cut there.

    With an even turn of v a substep, ``after`` substeps of which lie beyond the cut, the mean is
    between (after - 3) v and (after - 2) v beyond it. The fastest substep turns by a third of a
    full turn.
    """
    fastest = full_turn(radius) / 3
    misfit = np.zeros_like(before)
    for state, (way, after) in enumerate(_PASSING.tolist()):
        if way == 0:
            continue
        cut = 0.0 if way > 0 else -TURN
        beyond = way * (before[:, state] - cut)
        low, high = sorted(((after - 3) * fastest, (after - 2) * fastest))
        low, high = min(low, 0.0), max(high, 0.0)
        off = np.maximum(np.maximum(low - beyond, beyond - high), 0.0)
        misfit[:, state] = (_MISFIT * off) ** 2
    return misfit


def _followed(
    before: FloatArray, way: NDArray[np.int64], choices: list[NDArray[np.int64]], last: int
) -> FloatArray:
    """Return the angles of the best way, which ends in state ``last``."""
    states, jumps = [last], [0]
    for best in reversed(choices):
        former, jump = divmod(int(best[states[-1]]), len(_JUMPS))
        jumps[-1] = int(_JUMPS[jump])
        states.append(former)
        jumps.append(0)
    states.reverse()
    jumps.reverse()
    level, result = 0, []
    for frame, (state, jump) in enumerate(zip(states, jumps, strict=True)):
        level += jump
        result.append(before[frame, state] + TURN * level)
        level += int(way[state])
    return np.array(result, np.float64)
