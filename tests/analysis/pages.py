"""Whether the texts of a figure can be read."""

from __future__ import annotations

import itertools

from matplotlib.figure import Figure
from matplotlib.text import Text


def texts_apart(figure: Figure) -> int:
    """Return the number of texts; fail where one leaves the page or covers another."""
    figure.canvas.draw()
    found: list[Text] = [*figure.texts, *(t for box in figure.legends for t in box.get_texts())]
    for axes in figure.axes:
        found += [*axes.texts, axes._left_title]  # type: ignore[attr-defined]
        legend = axes.get_legend()
        found += [] if legend is None else legend.get_texts()
        if not axes.axison:
            continue
        for axis in (axes.xaxis, axes.yaxis):
            low, high = sorted(axis.get_view_interval())
            found += [t.label1 for t in axis.get_major_ticks() if low <= t.get_loc() <= high]
            found.append(axis.label)
    shown = [text for text in found if text.get_text() and text.get_visible()]
    # of labels without the lines that lead to them
    boxes = [(text.get_text(), Text.get_window_extent(text)) for text in shown]
    width, height = figure.canvas.get_width_height()
    for text, box in boxes:
        assert 0 <= box.x0 < box.x1 <= width, text
        assert 0 <= box.y0 < box.y1 <= height, text
    for (text, box), (other_text, other) in itertools.combinations(boxes, 2):
        assert not box.overlaps(other), (text, other_text)
    return len(boxes)
