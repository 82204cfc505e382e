"""What reports of runs and of evaluations have in common: bars, film strips, settings."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from phase_ppl.evaluation.observers import Observer
from phase_ppl.evaluation.report.html import (
    Child,
    Html,
    facts,
    join,
    more,
    number,
    png_of,
    rolled,
    table,
    tag,
)
from phase_ppl.render.stills import draw_strip
from phase_ppl.world.scene import Scene

PANELS: Final = 6
STRIP_WIDTH: Final = 1200
"""Pixels."""

LEAST: Final = 0.005
"""Probability below which it is 0 to a reader."""

_BAR: Final = 62
"""Width of the bar of probability 1, in percent of its column; the number stands beside it."""

DIAGNOSTICS: Final = {
    "kernel": "kernel",
    "validity": "validity",
    "weights": "weights",
    "particles": "particles",
    "iterations": "iterations",
    "acceptance_rate": "proposals accepted",
    "move_rate": "iterations with a change of goals",
    "distinct_goal_pairs": "distinct pairs of goals",
    "agreement": "particles that agree on the goal",
    "monte_carlo_error": "Monte-Carlo error of the leading goal",
    "simulations": "simulations",
    "frames_saved_share": "frames saved by stopping early",
    "aborted_mass_bound": "mass that stopped simulations can hide",
    "best_error_per_frame": "error of the best draw, units per frame",
}
"""Diagnostic -> how it is called where a few are shown."""


def bar(value: float, colour: str) -> Html:
    """Return a bar with its probability."""
    if value < LEAST:
        return tag("span", "0", class_="soft")
    style = f"width:{_BAR * value:.1f}%;background:{colour}"
    return join(tag("span", class_="bar", style=style), number(value))


def named(observer: Observer) -> Html:
    """Return an observer's name with its colour."""
    swatch = tag("span", class_="swatch", style=f"background:{observer.colour}")
    return tag("span", swatch, observer.label)


def bars(title: str, entries: Sequence[tuple[str, float]], colour: str) -> Html:
    """Return labelled bars of probabilities."""
    rows: list[list[Child]] = [[label, bar(value, colour)] for label, value in entries]
    return tag(
        "div",
        tag("h3", title),
        table(["answer", "probability"], rows, f"{title}: probabilities", class_="answers one"),
    )


def film_strip(
    trajectory: NDArray[np.float64], scene: Scene, caption: str, alt: str, panels: int = PANELS
) -> Html:
    """Return a film strip of a trajectory (time, entity, coord)."""
    picture = draw_strip(trajectory, min(panels, len(trajectory)), scene)
    image = png_of(picture, alt, STRIP_WIDTH * picture.width // (300 * panels))
    return tag("figure", rolled(image, caption, "strip"), tag("figcaption", caption))


def diagnostics(found: Mapping[str, Any]) -> Html:
    """Return the verdict, a few diagnostics, and all of them folded away."""
    few = {name: found[name] for name in DIAGNOSTICS if found.get(name) is not None}
    pairs = [(DIAGNOSTICS[name], in_words(value)) for name, value in few.items()]
    rest = {name: value for name, value in found.items() if name != "verdict"}
    return tag(
        "div",
        tag("p", str(found.get("verdict", "")), class_="verdict"),
        facts(pairs, "Diagnostics"),
        more("All diagnostics", facts(flat(rest), "All diagnostics")),
    )


def in_words(value: Any) -> str:
    """Return a plain value, such as of a JSON file, in a line of text."""
    if value is None:
        return "\N{EN DASH}"
    if isinstance(value, Mapping):
        return ", ".join(f"{str(k).replace('_', ' ')} {in_words(v)}" for k, v in value.items())
    if isinstance(value, list | tuple):
        return ", ".join(in_words(entry) for entry in value) or "none"
    if isinstance(value, bool):
        return "yes" if value else "no"
    if isinstance(value, float):
        return f"{value:.4g}".replace("-", "\N{MINUS SIGN}")
    return str(value)


def flat(record: Mapping[str, Any], above: str = "") -> Iterator[tuple[str, str]]:
    """Yield the path and the value, in words, of everything in nested mappings."""
    for key, value in record.items():
        path = f"{above}{key}"
        if isinstance(value, Mapping) and value:
            yield from flat(value, f"{path}.")
        else:
            yield path, in_words(value)
