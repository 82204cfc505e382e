"""What a vision-language model is asked: the content of the paper's prompt, in words of our own."""

from __future__ import annotations

from typing import Final

from phase_ppl.evaluation.prediction import GOAL_QUESTIONS
from phase_ppl.evaluation.vlm.film import Film
from phase_ppl.world.goals import GOALS, N_GOALS
from phase_ppl.world.names import AGENTS, ITEMS, LANDMARKS
from phase_ppl.world.relations import RELATIONS

N_NAMED: Final = 10
"""Goals that an answer names for each agent."""

_MEANING: Final = {
    "friendly": "they work towards the same goal",
    "neutral": "each minds its own business",
    "adversarial": "one hinders the other, or they are rivals",
}

_AGENTS: Final = " and ".join(AGENTS)

TEXT: Final = f"""\
{{shown}} Two agents move about a room, seen from above. What does each of them want, and how do \
they stand to each other?

What there is to see:
- {len(AGENTS)} agents, {_AGENTS}: trapezoids with two eyes. They move by themselves and can push, \
hold and carry things.
- {len(ITEMS)} items, {" and ".join(ITEMS)}: discs in light colours, which move only when an agent \
moves them.
- Agents and items come in several sizes; the larger, the heavier.
- {len(LANDMARKS)} landmarks, {", ".join(LANDMARKS)}: coloured squares ("lm") on the floor, places \
where an agent may want to be or to have something.
- Walls: black lines. Neither agents nor items get through them.

What an agent may want: to be at a landmark; to have an item at a landmark; to be near the other \
agent; or to prevent something of that kind, for instance to keep an agent or an item away from a \
landmark. For every choice of who or what and where there is one goal, {N_GOALS} in all. These are \
their names, and no others may be used:
{{goals}}

How the agents may stand to each other:
{{relations}}

Answer with a single JSON object and nothing before or after it. It has exactly three keys:
- "{GOAL_QUESTIONS[AGENTS[0]]}": the {N_NAMED} goals that the {AGENTS[0]} most probably has, each \
name with its probability; exactly {N_NAMED} different names, spelled as above, and probabilities \
that sum to 1.
- "{GOAL_QUESTIONS[AGENTS[1]]}": the same for the {AGENTS[1]}.
- "relation": the probabilities of {", ".join(f'"{name}"' for name in RELATIONS)}, all three of \
them, which sum to 1.

Its form, with the names and numbers still to be put in:
{{{{"goal_red": {{{{"<goal>": <probability>, and nine more}}}}, \
"goal_green": {{{{"<goal>": <probability>, and nine more}}}}, \
"relation": {{{{"friendly": <probability>, "neutral": <probability>, \
"adversarial": <probability>}}}}}}}}
"""


def prompt(film: Film, as_video: bool) -> str:
    """Return the question about a film.

    Args:
        film: is shown.
        as_video: whether as a video; else as pictures.
    """
    seconds = film.seconds
    shown = (
        "The video shows an animation."
        if as_video
        else f"The {len(seconds)} pictures are frames of one animation of {seconds[-1]:g} seconds, "
        "in the order of time, each with its time before it."
    )
    return TEXT.format(
        shown=shown,
        goals="\n".join(f"- {goal}" for goal in GOALS),
        relations="\n".join(f"- {name}: {_MEANING[name]}" for name in RELATIONS),
    )
