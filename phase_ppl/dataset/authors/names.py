"""File names of the authors' recordings, which say what was recorded.

Such as ``D082020_1817530_0_F8_E8.1_G['LMO', 0, 2, 1]_['LMO', 0, 2, 1]_ST3_1_..._R0.0_0.0_....mp4``:
a time stamp (here followed by the first of two observation switches, 0_0), the layout (8) and how
it was reflected (.1), a goal [type, entity, target, sign] and a strength per agent, red first, then
more that is not used here. Entities have the numbers of their colours: agents 0 red, 1 green, items
0 blue, 1 pink, in "TE" both; landmarks 0 blue, 1 green, 2 red, 3 yellow.
"""

from __future__ import annotations

import re
from typing import Final, NamedTuple

from phase_ppl.dataset.phase_test import strength_level
from phase_ppl.world.errors import InvalidEventError, shown
from phase_ppl.world.event import Truth
from phase_ppl.world.goals import GOALS, goal_index, goal_literal, literal_goal
from phase_ppl.world.hypothesis import STRENGTH_LEVELS
from phase_ppl.world.names import AGENTS, BLUE_ITEM, LANDMARKS, Literal, Predicate

Goal = tuple[str, int, int, int]
"""Type "LMO" (item, landmark), "LMA" (agent, landmark) or "TE" (agent, agent); entity; target;
sign 1 (to) or -1 (away from)."""

ALPHA: Final = 10.0  # weight of the other's goal, in names
_LONGEST: Final = 1000
_PLACE: Final = re.compile(
    r"(?P<stamp>.*?)_?(?P<switch>\d)_\d_[FI]\d_E(?P<layout>\d+)(?:\.(?P<copy>[0-3]))?(?=_|$)"
)
_PARAMETERS: Final = re.compile(
    r"_G(?P<goals>.*)_ST(?P<red>[0-3]|None)_(?P<green>[0-3]|None)(?=_|$)"
)
_BETWEEN: Final = "[^A-Za-z0-9-]+"
_GOAL: Final = re.compile(rf"([A-Z]+){_BETWEEN}(\d+){_BETWEEN}(\d+){_BETWEEN}(-?1)(?!\d)")
_STAMP: Final = re.compile(r"D\d{6}_\d{6}")
_ID: Final = re.compile(r"(D\d{6}_\d{6})(\d)_E(\d+)(?:\.([0-3]))?")
_SUFFIXES: Final = re.compile(r"\.(mp4|pik|pkl|pickle)$")


class Place(NamedTuple):
    """Where something was recorded."""

    layout: int  # number of the layout before any reflection
    # number of the reflection, 0 up-down, 1 left-right, 2 about y = x, 3 about y = -x; None for an
    # original
    copy: int | None

    @property
    def is_diagonal(self) -> bool:
        """Whether it was reflected about a diagonal, in which the angles were wrapped."""
        return self.copy in (2, 3)

    def __str__(self) -> str:
        return f"E{self.layout}" + ("" if self.copy is None else f".{self.copy}")


class Recorded(NamedTuple):
    """What a file name says."""

    id: str  # time stamp and place, or, in names that the authors did not give, what comes first
    place: Place | None  # None where the name does not say
    truth: Truth | None  # goals and strengths; None where the name does not say


def parse_name(name: str) -> Recorded:
    """Return what a file name says (InvalidEventError: too long, or its goals are none)."""
    if len(name) > _LONGEST:
        raise InvalidEventError(f"name is {shown(name)}, of more than {_LONGEST} characters")
    stem = _SUFFIXES.sub("", name)
    matches = list(_PLACE.finditer(stem))
    if not matches:
        return Recorded(stem, None, None)
    found = matches[-1]  # an id may look like part of a name
    stamp = stem[: found.start()] + found["stamp"]
    place = Place(int(found["layout"]), None if found["copy"] is None else int(found["copy"]))
    if _STAMP.fullmatch(stamp):
        stamp += f"{found['switch']}_{place}"
    return Recorded(stamp or stem, place, _truth(stem[found.end() :]))


def _truth(rest: str) -> Truth | None:
    found = _PARAMETERS.match(rest)
    if found is None:
        return None
    goals = _GOAL.findall(found["goals"])
    if len(goals) != len(AGENTS):
        raise InvalidEventError(
            f"name gives the goals {shown(found['goals'])}, expected one per agent such as "
            "['LMO', 0, 2, 1]"
        )
    red, green = (
        goal_string((kind, int(entity), int(target), int(sign)), holder)
        for holder, (kind, entity, target, sign) in enumerate(goals)
    )
    strengths = [
        None if found[agent] == "None" else STRENGTH_LEVELS[int(found[agent])]
        for agent in ("red", "green")
    ]
    return Truth(red, green, strength_red=strengths[0], strength_green=strengths[1])


def goal_string(goal: Goal, holder: int) -> str:
    """Return the paper's string of a goal that the agent ``holder`` has, if there is one."""
    kind, entity, target, sign = goal
    positive = sign > 0
    on_landmark = entity < len(AGENTS) and target < len(LANDMARKS)
    if kind == "LMO" and on_landmark:
        literal = Literal(Predicate.ON, BLUE_ITEM + entity, target, positive)
    elif kind == "LMA" and on_landmark:
        literal = Literal(Predicate.ON, entity, target, positive)
    elif kind == "TE" and {entity, target} == {0, 1}:  # chaser and chased, whoever holds it
        literal = Literal(Predicate.TOUCH, holder, 1 - holder, positive)
    else:
        raise InvalidEventError(f"goal {list(goal)} is none of the paper's {len(GOALS)} goals")
    return GOALS[literal_goal(literal)]


def goal_numbers(goal: str, holder: int) -> Goal:
    """Return what :func:`goal_string` turns into ``goal``, unless that names its own holder."""
    literal = goal_literal(goal_index(goal), holder)
    sign = 1 if literal.positive else -1
    if literal.predicate is Predicate.TOUCH:
        if literal.target == holder:
            raise InvalidEventError(f"goal {goal!r} names its own holder, the {AGENTS[holder]}")
        chaser, chased = (holder, 1 - holder) if literal.positive else (1 - holder, holder)
        return "TE", chaser, chased, sign
    if literal.subject >= BLUE_ITEM:
        return "LMO", literal.subject - BLUE_ITEM, literal.target, sign
    return "LMA", literal.subject, literal.target, sign


def place_in_id(id: str) -> Place | None:
    """Return the place in an id as the authors' recordings have them, else None."""
    found = _ID.fullmatch(id)
    if found is None:
        return None
    return Place(int(found[3]), None if found[4] is None else int(found[4]))


def file_name(id: str, place: Place, truth: Truth | None, n_frames: int) -> str:
    """Return a name that :func:`parse_name` takes apart again."""
    found = _ID.fullmatch(id)
    head = f"{found[1]}{found[2]}_0" if found and place == place_in_id(id) else f"{id}_0_0"
    parameters = alphas = ""
    if truth is not None:
        goals = "_".join(
            str(list(goal_numbers(goal, holder)))
            for holder, goal in enumerate((truth.goal_red, truth.goal_green))
        )
        red, green = map(strength_level, (truth.strength_red, truth.strength_green))
        parameters = f"_G{goals}_ST{red}_{green}"
        of_red = of_green = 0.0
        if truth.scenario == "opposing":  # whoever wants that something is not so hinders
            positive = goal_literal(goal_index(truth.goal_red), 0).positive
            of_red, of_green = (0.0, -ALPHA) if positive else (-ALPHA, 0.0)
        alphas = f"_R{of_red}_{of_green}"
    name = f"{head}_F8_{place}{parameters}_A0_0_C0_0_MCTS_L{n_frames - 1}{alphas}.mp4"
    if parse_name(name) != Recorded(id, place, truth):
        raise InvalidEventError(f"{name!r} would not say all of its id, place and truth")
    return name
