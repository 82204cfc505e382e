"""The closed loop reads a video: the hidden state, and how probable each frame is under every goal.

One thing has four names: the closed loop is the model, its likelihood, files and options are called
stepwise (``models/stepwise.py``, ``StepwisePosterior``), a filter is the pass through the frames,
and watching (``inference/stepwise.py``) is that pass while the frames come.
"""
