"""Settings of SIMPLE."""

from __future__ import annotations

import dataclasses
import math
from typing import Any, Literal

from phase_ppl.world.errors import InvalidSettingError, unknown_name


@dataclasses.dataclass(frozen=True)
class SimpleSettings:
    """Settings of SIMPLE's proposals and intervals; the defaults are the paper's (Appendix 4B).

    Attributes:
        eta: scaling factor of the interval draw.
        gamma: weight of distances in the goal proposal.
        window: length Delta T of a local interval, frames.
        prior_share: share of proposals drawn from the prior, so that every hypothesis can be
            reached (the paper's proposals have none).
        sign: "intended": near goals and progress are likely (the text); "printed": the formula
            as printed, which favours far goals.
        away_radius: an "away" goal counts as reached at this distance, in units of the arena's
            half width.
    """

    eta: float = 0.1
    gamma: float = 10.0
    window: int = 10
    prior_share: float = 0.1
    sign: Literal["intended", "printed"] = "intended"
    away_radius: float = 1.0

    def __post_init__(self) -> None:
        for name in ("eta", "gamma", "away_radius"):
            value = getattr(self, name)
            if not (math.isfinite(value) and value >= 0):
                raise InvalidSettingError(f"{name}={value!r}, expected a number >= 0")
        if not 0 < self.prior_share <= 1:
            raise InvalidSettingError(f"prior_share={self.prior_share!r}, expected 0 < share <= 1")
        if isinstance(self.window, bool) or not isinstance(self.window, int) or self.window < 1:
            raise InvalidSettingError(f"window={self.window!r}, expected a whole number >= 1")
        if self.sign not in ("intended", "printed"):
            raise unknown_name("sign", self.sign, ("intended", "printed"))

    def to_dict(self) -> dict[str, Any]:
        return dataclasses.asdict(self)
