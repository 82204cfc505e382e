"""Models of how people judge events: observers, their fits, and designs of studies.

An application of phase_ppl that uses its public names only. It is reached by ``ppl.fit_people``,
``ppl.observers`` and ``ppl.design``.
"""
