"""Films back into events: a video file's frames, the layout in them, and the bodies' tracks.

An application of phase_ppl, of which it uses public names only; ``ppl.read_video`` is its way in.
"""
