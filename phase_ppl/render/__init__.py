"""Pictures and animations of events in the look of the PHASE videos."""

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
