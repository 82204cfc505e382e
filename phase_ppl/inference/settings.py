"""Settings of SIMPLE and the size of a run."""

from __future__ import annotations

import dataclasses
from typing import Final, Literal

from phase_ppl.inference.proposals.strength import DEFAULT_ESTIMATOR, Estimator, strength_estimator
from phase_ppl.inference.proposals.tables import (
    FORMS,
    SIGNS,
    BottomUpTables,
    Form,
    Sign,
    bottom_up_tables,
)
from phase_ppl.world.checks import nonnegative_number, number_or_nan, positive_number, whole_number
from phase_ppl.world.errors import InvalidSettingError, shown, unknown_name
from phase_ppl.world.observation import Observation
from phase_ppl.world.scene import Scene


@dataclasses.dataclass(frozen=True)
class SimpleSettings:
    """Settings of SIMPLE; the numbers are the paper's (Appendix 4).

    Attributes:
        eta: weight of the errors in the choice of a window, 1 / units.
        proposal: of goals: "learned", features of what the agents did, with learned weights; or
            "paper", distances alone, to which ``gamma`` and ``sign`` apply.
        gamma: weight of the distances in the paper's proposal of goals.
        window: Delta T, steps; shorter where the observation is.
        beta: replaces that of the model's radial likelihood, 1 / units; None: keep the model's,
            by default the paper's 0.05.
        prior_share: weight of the prior in the proposal.
        sign: "intended": goals that are close are proposed; "printed": as the paper's formula.
        strength: what estimates the strengths of the proposal: a name of
            :data:`~phase_ppl.inference.proposals.strength.ESTIMATORS`, or an estimator.

    Raises:
        InvalidSettingError: a value is out of range.
        UnknownNameError: an unknown proposal, sign or estimator.
    """

    eta: float = 0.1
    proposal: Form = "learned"
    gamma: float = 10.0
    window: int = 10
    beta: float | None = None
    prior_share: float = 0.1
    sign: Sign = "intended"
    strength: str | Estimator = DEFAULT_ESTIMATOR

    def __post_init__(self) -> None:
        for name in ("eta", "gamma"):
            nonnegative_number(name, getattr(self, name))
        if not 0 < number_or_nan(self.prior_share) < 1:
            raise InvalidSettingError(
                f"prior_share={shown(self.prior_share)}, expected a number in (0, 1)"
            )
        whole_number("window", self.window)
        for name, allowed in (("sign", SIGNS), ("proposal", FORMS)):
            if getattr(self, name) not in allowed:
                raise unknown_name(name, getattr(self, name), allowed)
        learned = self.proposal != "paper"
        if learned and (self.gamma, self.sign) != (SimpleSettings.gamma, SimpleSettings.sign):
            raise InvalidSettingError(
                f"gamma={self.gamma:g} and sign={self.sign!r} are settings of proposal='paper'; "
                f"it is {self.proposal!r}"
            )
        strength_estimator(self.strength)

    def tables(self, scene: Scene, observation: Observation) -> BottomUpTables:
        """Return what the windows of an observation suggest under these settings."""
        return bottom_up_tables(
            scene,
            observation,
            window=self.window,
            form=self.proposal,
            gamma=self.gamma,
            sign=self.sign,
            strength=self.strength,
        )


def probability(name: str, value: object) -> float:
    """Return ``value`` if it is a number in [0, 1]."""
    number = number_or_nan(value)
    if not 0 <= number <= 1:
        raise InvalidSettingError(f"{name}={shown(value)}, expected a number in [0, 1]")
    return number


BUDGETS: Final = "phase_ppl.simulations(n), phase_ppl.frames(n) or phase_ppl.seconds(n)"


@dataclasses.dataclass(frozen=True)
class Budget:
    """What a run may cost, in "simulations", "frames" or "seconds"."""

    amount: float
    unit: Literal["simulations", "frames", "seconds"]

    def __str__(self) -> str:
        return f"{self.amount} {self.unit}"


def simulations(n: int) -> Budget:
    """Return a budget of ``n`` simulations, the initial ones included.

    Those count that were really run: a proposal without prior mass, or one whose simulation is
    known, costs nothing; one that is stopped early counts as one. An iteration that has begun is
    finished, so that a run makes up to one iteration's simulations of all particles more. What
    fails and is run again (``on_failure="retry"``) comes on top.

    Raises:
        InvalidSettingError: ``n`` is no whole number >= 1.
    """
    return Budget(whole_number("simulations", n), "simulations")


def frames(n: int) -> Budget:
    """Return a budget of ``n`` simulated frames, those of the initial particles included.

    As :func:`simulations`, but a simulation that is stopped early counts for the frames that it
    took, so that a kernel that stops simulations early gets more of them. How long such a run is
    thus depends a little on what its chains meet.

    Raises:
        InvalidSettingError: ``n`` is no whole number >= 1.
    """
    return Budget(whole_number("frames", n), "frames")


def seconds(n: float) -> Budget:
    """Return a budget of ``n`` seconds of wall time, from the call on.

    The initial particles are simulated in any case, unless one takes longer than all the seconds.
    No iteration begins of which those before let expect that it ends too late, so a run rarely
    takes longer, and often somewhat less; one that goes on for a tenth longer is given up.

    Raises:
        InvalidSettingError: ``n`` is no positive number.
    """
    return Budget(positive_number("seconds", n), "seconds")
