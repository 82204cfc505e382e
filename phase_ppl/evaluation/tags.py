"""What happens in videos, in people's words: the paper's 23 labels (Appendix A.1)."""

from __future__ import annotations

from typing import Final

LABELS: Final = (
    "not interacting",
    "interacting unintentionally",
    "chasing",
    "running away",
    "stalking",
    "approaching",
    "avoiding",
    "meeting",
    "gathering together",
    "guiding",
    "following the lead (of another agent)",
    "playing a game of tag",
    "blocking",
    "fighting",
    "competing",
    "stealing",
    "protecting an object",
    "attacking",
    "hindering",
    "bullying",
    "playing tug of war",
    "helping",
    "collaborating",
)
"""In the paper's order and words."""
