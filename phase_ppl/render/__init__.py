"""Pictures and animations of events in the look of the PHASE videos.

The argument ``what`` of functions is an :class:`phase_ppl.Event`, :class:`phase_ppl.Observation` or
array (time, entity, coord) of x, y [units] and angle [rad]. All except an event need a ``scene``.
"""

from phase_ppl.render.frames import Painter, contact_sheet, draw_frame, field_of_view, image, strip
from phase_ppl.render.video import video, videos

__all__ = [
    "Painter",
    "contact_sheet",
    "draw_frame",
    "field_of_view",
    "image",
    "strip",
    "video",
    "videos",
]


def __dir__() -> list[str]:
    return __all__
