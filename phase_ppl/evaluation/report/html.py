"""Pages made from templates (Jinja2), with their pictures, style and script inside.

Whatever a template is given becomes text: it is escaped unless a template itself made it. The
page's policy lets the browser fetch nothing and run no script but the page's own, which it knows by
its hash.
"""

from __future__ import annotations

import base64
import functools
import hashlib
import io
from collections.abc import Iterator, Mapping
from typing import TYPE_CHECKING, Any, Final, NamedTuple

from jinja2 import Environment, PackageLoader, StrictUndefined
from markupsafe import Markup

import phase_ppl
from phase_ppl.evaluation.cells import number

if TYPE_CHECKING:
    from matplotlib.figure import Figure
    from PIL import Image

COLOURS: Final = 256
"""Colours of pictures of events, flat areas and a few thin lines; fewer change those of items."""

LEAST: Final = 0.005  # probability below which it is 0 to a reader

_SCREEN: Final = 104
"""Pixels on the screen for an inch of a figure: its small print can just be read."""


class Picture(NamedTuple):
    """A picture as part of a page: its content as an address, and its size on the screen."""

    source: str
    alt: str
    width: int
    height: int


def page(template: str, **content: Any) -> str:
    """Return the page that a template, such as "run.html", makes of its content."""
    return _environment().get_template(template).render(content) + "\n"


def picture_of(image: Image.Image, alt: str, width: int) -> Picture:
    """Return a picture of an event, ``width`` pixels wide at most."""
    small = image
    if image.width > width:
        small = image.resize((width, round(image.height * width / image.width)))
    buffer = io.BytesIO()
    small.quantize(COLOURS).save(buffer, "PNG", optimize=True)
    return Picture(embedded(buffer.getvalue(), "image/png"), alt, small.width, small.height)


def figure_of(figure: Figure, alt: str, dpi: int = 160) -> Picture:
    """Return a matplotlib figure, a little larger than on paper."""
    buffer = io.BytesIO()
    figure.savefig(buffer, format="png", dpi=dpi)
    width, height = (round(inches * _SCREEN) for inches in figure.get_size_inches())
    return Picture(embedded(buffer.getvalue(), "image/png"), alt, width, height)


def embedded(content: bytes, kind: str) -> str:
    """Return an address that holds its content, of a MIME type such as "video/mp4"."""
    return f"data:{kind};base64,{base64.b64encode(content).decode()}"


def in_words(value: Any) -> str:
    """Return a plain value, such as of a JSON file, in a line of text."""
    if value is None:
        return number(None)
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


@functools.cache
def _environment() -> Environment:
    loader = PackageLoader(__package__)
    made = Environment(
        loader=loader,
        autoescape=True,
        undefined=StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
    )
    made.filters |= {"number": number, "in_words": in_words, "flat": flat}
    style, script = (Markup(loader.get_source(made, f"page.{kind}")[0]) for kind in ("css", "js"))
    digest = base64.b64encode(hashlib.sha256(script.encode()).digest()).decode()
    policy = (
        "default-src 'none'; img-src data:; media-src data:; style-src 'unsafe-inline'; "
        f"script-src 'sha256-{digest}'; base-uri 'none'; form-action 'none'"
    )
    made.globals |= {
        "style": style,
        "script": script,
        "policy": policy,
        "least": LEAST,
        "version": phase_ppl.__version__,
    }
    return made
