"""Events read from films: a video file's frames, their layout, and the bodies' tracks.

An application of phase_ppl that uses its public names only. It is reached by ``ppl.read_video``.
"""
