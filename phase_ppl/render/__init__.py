"""Pictures and animations of events in the look of the PHASE videos."""

from phase_ppl.render.frames import draw_frame
from phase_ppl.render.stills import image, strip
from phase_ppl.render.video import video

__all__ = ["draw_frame", "image", "strip", "video"]
