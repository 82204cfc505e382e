"""Where people hesitate, and which events to ask them about: observers, their fits, designs.

An application of phase_ppl, of which it uses public names only; its ways in are ``ppl.fit_people``,
``ppl.observers`` and ``ppl.design``.
"""
