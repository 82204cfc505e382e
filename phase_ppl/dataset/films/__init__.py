"""Films back into events: a video file's frames, the layout in them, and the bodies' tracks."""
