"""Pictures and animations of events in the look of the PHASE videos."""

from phase_ppl.render.contact_sheet import contact_sheet
from phase_ppl.render.frames import draw_frame
from phase_ppl.render.stills import image, strip
from phase_ppl.render.video import video
from phase_ppl.render.videos import videos

__all__ = ["contact_sheet", "draw_frame", "image", "strip", "video", "videos"]
