"""Whether what was read step by step can be trusted: numbers, and a verdict in words."""

from __future__ import annotations

import itertools
from collections.abc import Mapping
from typing import TYPE_CHECKING, Any, Final

import numpy as np

from phase_ppl.dataset.generation.situation import overlaps
from phase_ppl.world.arrays import FloatArray
from phase_ppl.world.names import ENTITIES

if TYPE_CHECKING:
    from phase_ppl.analysis.stepwise_posterior import StepwisePosterior


UNEXPLAINED: Final = 17.0
"""Nats below a perfect match, after the best pair of actions, from which on a frame counts as
explained by no action: one body some 3 units from where it could be. 41 real videos without noise
have none (16 at most); of the model's own videos, whose positions have noise of heavy tails, 3 %
of the frames come to as much (``benchmarks/stepwise.py calibration``)."""

SURPRISE: Final = 4.1
"""Nats by which what was done was less probable than one sure action, beyond what is unexplained;
the model's own videos have ``SURPRISING`` of their frames above it
(``benchmarks/stepwise.py calibration``)."""

SURPRISING: Final = 0.1
_TOO_SURPRISING: Final = 0.5
"""Share of such frames from which on the agents are said not to do what any goals make likely."""

SHRUNK: Final = 0.8
"""Part of their size with which bodies must meet to be said to lie on each other: in contact they
press into each other a little."""

DISAGREE: Final = 0.1
"""Standard error of a leading probability from which on the sets of searches disagree."""

_NAMED: Final = 3
"""Frames that a verdict names."""


def diagnostics(post: StepwisePosterior) -> dict[str, Any]:
    """Return what speaks for and against a posterior; see ``StepwisePosterior.diagnostics``."""
    found = post.dataset.isel(time=slice(None, post.frame + 1))
    unexplained = np.array(found["unexplained"].values, float)
    surprise = post.surprise() - unexplained
    leading = {name: post.top(name, 1)[0] for name in ("goal_red", "goal_green", "relation")}
    known = np.isfinite(surprise[1:])
    result = {
        "frames": post.frame + 1,
        "planner_seeds": post.planner_seeds,
        "weight": float(found.attrs["weight"]),
        "leading": {name: {"label": label, "probability": float(share), "error": share.error}
                    for name, (label, share) in leading.items()},
        "surprise_median": float(np.median(surprise[1:])) if known.any() else None,
        "surprise_reference": SURPRISE,
        "surprising_share": float((surprise[1:] > SURPRISE).mean()) if known.any() else None,
        "unexplained_most": float(unexplained[1:].max()) if known.any() else None,
        "unexplained_frames": np.flatnonzero(unexplained > UNEXPLAINED).tolist(),
        "overlapping_frames": overlapping(post.observed(), found["radius"].values,
                                          found["walls"].values),
    }  # fmt: skip
    return {**result, "verdict": verdict(result)}


def overlapping(trajectory: FloatArray, radius: FloatArray, walls: FloatArray) -> list[int]:
    """Return the frames in which bodies lie on each other, or in a wall.

    Args:
        trajectory: (time, entity, coord), units and rad.
        radius: (entity,) units; walls: (n, 2, 2).
    """
    small = SHRUNK * radius
    near = np.full(len(trajectory), len(walls) > 0)
    for one, other in itertools.combinations(range(len(ENTITIES)), 2):
        apart = np.hypot(*(trajectory[:, one, :2] - trajectory[:, other, :2]).T)
        # an agent reaches 3 radii from its origin at most
        near |= apart < 3 * (radius[one] + radius[other])
    return [t for t in np.flatnonzero(near).tolist() if overlaps(trajectory[t], small, walls)]


def verdict(found: Mapping[str, Any]) -> str:
    """Return in a few sentences whether the posterior can be trusted, the worst sign first.

    Args:
        found: what :func:`diagnostics` collects.
    """
    n = found["frames"] - 1
    signs = []
    if found["unexplained_frames"]:
        signs.append(
            f"No action explains {_frames(found['unexplained_frames'])}: a body is where nothing "
            "could have put it. The probabilities hold only for a video that this is not."
        )
    if found["overlapping_frames"]:
        signs.append(
            f"Bodies lie on each other or in a wall in {_frames(found['overlapping_frames'])}, "
            "which bodies of this world cannot: what they do there says little of goals."
        )
    share = found["surprising_share"]
    if share is not None and share > _TOO_SURPRISING:
        signs.append(
            f"{share:.0%} of the frames surprise whatever the goals, where the model's own videos "
            f"have {SURPRISING:.0%}: these agents act otherwise than it expects."
        )
    errors = {name: one["error"] for name, one in found["leading"].items()}
    worst = max(errors, key=lambda name: np.nan_to_num(errors[name]))
    if found["planner_seeds"] > 1 and errors[worst] > DISAGREE:
        signs.append(
            f"The {found['planner_seeds']} sets of searches disagree on {worst} (standard error "
            f"{errors[worst]:.2f}): use more, planner_seeds={2 * found['planner_seeds']}."
        )
    if found["planner_seeds"] == 1 and n:
        signs.append(
            "With one set of searches nothing tells how much of this is the planner's chance."
        )
    if found["surprising_share"] is None and n:
        signs.append("Nothing was kept that would tell whether the model expects such a video.")
    if n == 0:
        signs.append("Nothing was seen but the start: this is the prior.")
    if not signs:
        signs.append(
            f"Actions explain every frame, {1 - share:.0%} of them are such as the model expects, "
            f"and the {found['planner_seeds']} sets of searches agree (largest standard error of "
            f"a leading probability: {errors[worst]:.2g})."
        )
    return " ".join(signs)


def _frames(frames: list[int]) -> str:
    named = ", ".join(map(str, frames[:_NAMED]))
    if len(frames) > _NAMED:
        return f"{len(frames)} frames ({named}, ...)"
    return f"frame{'s' if len(frames) > 1 else ''} {named}"
