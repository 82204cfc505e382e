"""The paper's studies of people, in the browser: judgments, tags, played sessions, likeness.

An application of phase_ppl that uses its public names only.
"""

from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from phase_study.study import Study

__all__ = ["Study"]


def __getattr__(name: str) -> Any:
    if name != "Study":
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    from phase_study.study import Study  # only when used: the list of commands does without it

    return Study


def __dir__() -> list[str]:
    return __all__
