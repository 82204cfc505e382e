"""Reading a video step by step: the hidden state, and how probable each frame is under every goal.

Users know it as the stepwise likelihood (``models/stepwise.py``), as watching
(``inference/stepwise.py``) and as ``StepwisePosterior``.
"""
