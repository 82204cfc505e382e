"""Whether the texts of a figure can be read."""

from __future__ import annotations

import itertools

from matplotlib.figure import Figure
from matplotlib.text import Text


def texts_of(figure: Figure) -> list[Text]:
    """Return all texts that are seen once the figure is drawn."""
    figure.draw_without_rendering()
    found: list[Text] = [*figure.texts, *(t for box in figure.legends for t in box.get_texts())]
    for axes in figure.axes:
        if not axes.get_visible():
            continue
        found += [*axes.texts, axes.title, axes._left_title, axes._right_title]  # type: ignore[attr-defined]
        legend = axes.get_legend()
        found += [] if legend is None else legend.get_texts()
        if not axes.axison:
            continue
        for axis in (axes.xaxis, axes.yaxis):
            low, high = sorted(axis.get_view_interval())
            ticks = [tick for tick in axis.get_major_ticks() if low <= tick.get_loc() <= high]
            found += [axis.label, *(label for t in ticks for label in (t.label1, t.label2))]
    return [text for text in found if text.get_text().strip() and text.get_visible()]


def texts_apart(figure: Figure) -> int:
    """Return the number of texts; fail where one leaves the page or covers another."""
    # of labels without the lines that lead to them; slanted ones have no boxes of their own
    shown = [text for text in texts_of(figure) if not text.get_rotation() % 90]
    boxes = [(text.get_text(), Text.get_window_extent(text)) for text in shown]
    width, height = figure.canvas.get_width_height()
    for text, box in boxes:
        assert 0 <= box.x0 < box.x1 <= width, text
        assert 0 <= box.y0 < box.y1 <= height, text
    for (text, box), (other_text, other) in itertools.combinations(boxes, 2):
        apart = box.x1 <= other.x0 + 1 or other.x1 <= box.x0 + 1
        apart |= box.y1 <= other.y0 + 1 or other.y1 <= box.y0 + 1
        assert apart, (text, other_text)
    return len(boxes)
