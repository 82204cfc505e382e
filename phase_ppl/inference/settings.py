"""Settings of SIMPLE and the size of a run."""

from __future__ import annotations

import dataclasses
import math

from phase_ppl.inference.proposals import SIGNS, Sign
from phase_ppl.inference.strength.estimates import Estimator
from phase_ppl.inference.strength.estimators import DEFAULT_ESTIMATOR, strength_estimator
from phase_ppl.world.errors import InvalidSettingError, shown, unknown_name


@dataclasses.dataclass(frozen=True)
class SimpleSettings:
    """Settings of SIMPLE; the numbers are the paper's (Appendix 4).

    Attributes:
        eta: weight of the errors in the choice of a window, 1 / units.
        gamma: weight of the distances in the proposal of goals.
        window: Delta T, steps; shorter where the observation is.
        beta: replaces that of the model's radial likelihood, 1 / units; None: keep the model's,
            by default the paper's 0.05.
        prior_share: weight of the prior in the proposal.
        sign: "intended": goals that are close are proposed; "printed": as the paper's formula.
        strength: what estimates the strengths of the proposal: a name of
            :data:`~phase_ppl.inference.strength.estimators.ESTIMATORS`, or an estimator.

    Raises:
        InvalidSettingError: a value is out of range.
        UnknownNameError: an unknown sign or estimator.
    """

    eta: float = 0.1
    gamma: float = 10.0
    window: int = 10
    beta: float | None = None
    prior_share: float = 0.1
    sign: Sign = "intended"
    strength: str | Estimator = DEFAULT_ESTIMATOR

    def __post_init__(self) -> None:
        for name in ("eta", "gamma"):
            value = getattr(self, name)
            if not (_is_number(value) and value >= 0):
                raise InvalidSettingError(f"{name}={shown(value)}, expected a number >= 0")
        if not (_is_number(self.prior_share) and 0 < self.prior_share < 1):
            raise InvalidSettingError(
                f"prior_share={shown(self.prior_share)}, expected a number in (0, 1)"
            )
        whole_number("window", self.window)
        if self.sign not in SIGNS:
            raise unknown_name("sign", self.sign, SIGNS)
        strength_estimator(self.strength)


def _is_number(value: object) -> bool:
    return isinstance(value, int | float) and not isinstance(value, bool) and math.isfinite(value)


def whole_number(name: str, value: object, minimum: int = 1) -> int:
    """Return ``value`` if it is a whole number of at least ``minimum``.

    Raises:
        InvalidSettingError: it is not.
    """
    if isinstance(value, bool) or not isinstance(value, int) or value < minimum:
        raise InvalidSettingError(f"{name}={shown(value)}, expected a whole number >= {minimum}")
    return value


@dataclasses.dataclass(frozen=True)
class Budget:
    """A cap on the number of simulations, the initial ones included."""

    simulations: int

    def iterations(self, chains: int, sims_per_step: int) -> int:
        """Return how many iterations of ``chains`` particles the budget allows.

        Raises:
            InvalidSettingError: not one beside the initial particles.
        """
        iterations = (self.simulations - chains) // (chains * sims_per_step)
        if iterations < 1:
            raise InvalidSettingError(
                f"a budget of {self.simulations} simulations is too small: {chains} initial "
                f"particles and one iteration need {chains * (1 + sims_per_step)}"
            )
        return iterations


def simulations(n: int) -> Budget:
    """Return a budget of ``n`` simulations, the initial ones included.

    Raises:
        InvalidSettingError: ``n`` is no whole number >= 1.
    """
    return Budget(whole_number("simulations", n))
