"""An example of every scenario, as film strips."""

from __future__ import annotations

from typing import TYPE_CHECKING, Final

import numpy as np

from phase_ppl.analysis.style import SMALL
from phase_ppl.evaluation.figures.results import SCENARIO_COLOURS, Results
from phase_ppl.evaluation.sheet import GREY, WIDTH, Sheet, fitting
from phase_ppl.render.stills import draw_strip
from phase_ppl.world.event import Event
from phase_ppl.world.relations import SCENARIOS

if TYPE_CHECKING:
    from matplotlib.figure import Figure

_PANELS: Final = 6
_HEADING: Final = 0.24


def film_strips(results: Results) -> Figure:
    """Draw the first event of every true scenario; without truth, the first event."""
    chosen = _examples(results)
    strips = [
        np.asarray(draw_strip(event, min(_PANELS, event.observation.n_frames)))
        for _, event in chosen
    ]
    inches = WIDTH / max(picture.shape[1] for picture in strips)
    sheet = Sheet(WIDTH, sum(_HEADING + picture.shape[0] * inches for picture in strips) + 0.05)
    top = 0.0
    for (name, event), picture in zip(chosen, strips, strict=True):
        colour = SCENARIO_COLOURS.get(name, GREY)
        sheet.write(0.1, top + 0.18, name or "scenario not known", colour=colour, weight="bold")
        goals = _goals(event)
        sheet.write(
            WIDTH - 0.1, top + 0.18, goals, size=fitting(goals, 5.6, SMALL), colour=GREY,
            ha="right",
        )  # fmt: skip
        top += _HEADING
        size = picture.shape[0] * inches
        axes = sheet.axes(0.0, top, picture.shape[1] * inches, size)
        axes.imshow(picture, interpolation="antialiased")
        axes.set_axis_off()
        top += size
    return sheet.figure


def _examples(results: Results) -> list[tuple[str, Event]]:
    found: dict[str, Event] = {}
    for event in results.events:
        found.setdefault(results.scenarios.get(event.id, ""), event)
    known: list[tuple[str, Event]] = [(name, found[name]) for name in SCENARIOS if name in found]
    return known or [("", found[""])]


def _goals(event: Event) -> str:
    if event.truth is None:
        return event.id
    return f"red: {event.truth.goal_red}; green: {event.truth.goal_green}"
