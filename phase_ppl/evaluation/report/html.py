"""HTML that cannot be broken by what is put into it, and the shell of a page.

Text becomes HTML in :func:`tag` only, which escapes it. The page's policy lets the browser fetch
nothing and run no script but the page's own, which it knows by its hash.
"""

from __future__ import annotations

import base64
import hashlib
import html
import io
from collections.abc import Iterable
from importlib import resources
from typing import TYPE_CHECKING, Any, Final

if TYPE_CHECKING:
    from matplotlib.figure import Figure
    from PIL import Image

VOID: Final = ("meta", "img", "input", "br")
COLOURS: Final = 256
"""Colours of pictures of events, flat areas and a few thin lines; fewer change those of items."""

_SCREEN: Final = 104
"""Pixels on the screen for an inch of a figure: its small print can just be read."""


class Html(str):
    """Text that is HTML already."""

    __slots__ = ()


Child = str | Iterable[Any] | None
"""Text, HTML, any number of those, or nothing."""


def tag(name: str, /, *children: Child, **attributes: str | int | bool | None) -> Html:
    """Return an element. Text that is not :class:`Html` is escaped, and so are attributes.

    Args:
        name: of the element.
        *children: its content.
        **attributes: a trailing or inner underscore of a name stands for none and for a hyphen
            (``class_``, ``aria_label``); True gives a bare attribute, False and None none.
    """
    parts = [f"<{name}"]
    for key, value in attributes.items():
        if value is None or value is False:
            continue
        label = key.rstrip("_").replace("_", "-")
        parts.append(f" {label}" if value is True else f' {label}="{html.escape(str(value))}"')
    parts.append(">")
    if name in VOID:
        return Html("".join(parts))
    return Html("".join(parts) + join(*children) + f"</{name}>")


def join(*children: Child) -> Html:
    """Return the children one after another, text escaped."""
    parts: list[str] = []
    for child in children:
        if isinstance(child, Html):
            parts.append(child)
        elif isinstance(child, str):
            parts.append(html.escape(child))
        elif child is not None:
            parts.append(join(*child))
    return Html("".join(parts))


def page(title: str, *sections: Child) -> str:
    """Return a whole page with its style and its script."""
    style, script = _part("page.css"), _part("page.js")
    digest = base64.b64encode(hashlib.sha256(script.encode()).digest()).decode()
    policy = (
        "default-src 'none'; img-src data:; media-src data:; style-src 'unsafe-inline'; "
        f"script-src 'sha256-{digest}'; base-uri 'none'; form-action 'none'"
    )
    head = tag(
        "head",
        tag("meta", charset="utf-8"),
        tag("meta", http_equiv="Content-Security-Policy", content=policy),
        tag("meta", name_="viewport", content="width=device-width, initial-scale=1"),
        tag("title", title),
        tag("style", Html(style)),
    )
    body = tag("body", tag("main", *sections), tag("script", Html(script)))
    return "<!doctype html>\n" + tag("html", head, "\n", body, lang="en") + "\n"


def section(title: str, *children: Child) -> Html:
    """Return a section under a heading of the second level."""
    return tag("section", tag("h2", title), *children)


def table(heads: list[Child], rows: list[list[Child]], label: str, class_: str = "") -> Html:
    """Return a table whose first column names the rows; it scrolls where it is too wide.

    Args:
        heads: of the columns.
        rows: of cells; the first is the head of its row.
        label: what the table holds, for those who do not see it.
        class_: of the table.
    """
    top = tag("thead", tag("tr", [tag("th", head, scope="col") for head in heads]))
    body = tag(
        "tbody",
        [
            tag("tr", tag("th", row[0], scope="row"), [tag("td", cell) for cell in row[1:]])
            for row in rows
        ],
    )
    content = tag("table", tag("caption", label, class_="unseen"), top, body, class_=class_ or None)
    return tag("div", content, class_="wide", role="region", aria_label=label, tabindex=0)


def facts(pairs: Iterable[tuple[str, str]], label: str) -> Html:
    """Return names with values, as a table of two columns."""
    rows: list[list[Child]] = [[name, value] for name, value in pairs]
    return table(["name", "value"], rows, label, class_="facts")


def more(title: str, *children: Child) -> Html:
    """Return what is shown when it is asked for."""
    return tag("details", tag("summary", title), *children)


def png_of(picture: Image.Image, alt: str, width: int) -> Html:
    """Return a picture of an event as part of the page, ``width`` pixels wide at most."""
    small = picture
    if picture.width > width:
        small = picture.resize((width, round(picture.height * width / picture.width)))
    buffer = io.BytesIO()
    small.quantize(COLOURS).save(buffer, "PNG", optimize=True)
    return _image(buffer.getvalue(), alt, small.width, small.height)


def figure_of(figure: Figure, alt: str, dpi: int = 160) -> Html:
    """Return a matplotlib figure as part of the page, a little larger than on paper."""
    buffer = io.BytesIO()
    figure.savefig(buffer, format="png", dpi=dpi)
    width, height = figure.get_size_inches()
    return _image(buffer.getvalue(), alt, round(width * _SCREEN), round(height * _SCREEN))


def rolled(picture: Html, label: str, class_: str = "") -> Html:
    """Return a picture that scrolls sideways where it is too wide."""
    class_ = f"roll {class_}".strip()
    return tag("div", picture, class_=class_, role="region", aria_label=label, tabindex=0)


def film(content: bytes, label: str) -> Html:
    """Return an MP4 film as part of the page."""
    source = "data:video/mp4;base64," + base64.b64encode(content).decode()
    return tag("video", label, src=source, controls=True, preload="metadata", aria_label=label)


def number(value: Any, digits: int = 2) -> str:
    """Return a number as it is read; a dash where there is none."""
    if value is None:
        return "\N{EN DASH}"
    return f"{value:.{digits}f}".replace("-", "\N{MINUS SIGN}")


def _image(content: bytes, alt: str, width: int, height: int) -> Html:
    source = "data:image/png;base64," + base64.b64encode(content).decode()
    return tag("img", src=source, alt=alt, width=width, height=height, loading="lazy")


def _part(name: str) -> str:
    return resources.files(__package__).joinpath(name).read_text(encoding="utf-8")
