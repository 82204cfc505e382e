"""The closed loop reads a video: the hidden state, and how probable each frame is under every goal.

The closed loop is the model, with its likelihood (``models/closed_loop.py``). The filter is the
pass through the frames; watching (``inference/closed_loop.py``) is that pass while frames come.
"""
