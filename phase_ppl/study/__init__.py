"""The paper's studies of people, in the browser: judgments, tags, played sessions, likeness."""

from phase_ppl.study.study import Study

__all__ = ["Study"]


def __dir__() -> list[str]:
    return __all__
