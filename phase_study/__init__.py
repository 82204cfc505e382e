"""Studies of people in the browser, as in the paper, and live games that the model reads.

An application of phase_ppl that uses its public names only.
"""

import importlib
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from phase_study.experiments import Likeness, Tags
    from phase_study.live import Live
    from phase_study.study import Study

__all__ = ["Likeness", "Live", "Study", "Tags"]

_MODULES = {"Likeness": "experiments", "Live": "live", "Study": "study", "Tags": "experiments"}


def __getattr__(name: str) -> Any:
    # only when used: the list of commands does without them
    if name in _MODULES:
        return getattr(importlib.import_module(f"{__name__}.{_MODULES[name]}"), name)
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")


def __dir__() -> list[str]:
    return __all__
