"""How long a run is and what it may cost, known before anything is simulated."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, Final, NamedTuple

from phase_ppl.inference.registry import KernelInfo
from phase_ppl.inference.settings import Budget, FrameBudget, TimeBudget
from phase_ppl.world.checks import whole_number
from phase_ppl.world.errors import InvalidSettingError, shown

ITERATIONS: Final = 6
"""L, the paper's number of iterations."""


class Length(NamedTuple):
    """Length of a run.

    Attributes:
        iterations: L, after the initial particles; None: until the budget is spent.
        sims_at_start: the most simulations of each initial particle.
        sims_per_step: the most simulations that an iteration takes per particle. Kernels declare
            it; what they spend is counted.
        seconds: of wall time that the run may take; None: any.
        simulations: to be made; None: any number.
        frames: to be simulated; None: any number.
    """

    iterations: int | None
    sims_at_start: int
    sims_per_step: int
    seconds: float | None = None
    simulations: int | None = None
    frames: int | None = None

    def at_most(self, chains: int, iterations: int) -> int:
        """Return the most simulations that so many iterations take."""
        return chains * (self.sims_at_start + iterations * self.sims_per_step)

    @property
    def target(self) -> dict[str, Any]:
        """What ends the run, as a file keeps it."""
        names = ("iterations", "seconds", "simulations", "frames")
        return {name: getattr(self, name) for name in names}


def budget_of(target: Mapping[str, Any]) -> Budget | FrameBudget | TimeBudget | None:
    """Return the budget of a :attr:`Length.target`; None: it is a number of iterations."""
    if target.get("simulations") is not None:
        return Budget(target["simulations"])
    if target.get("frames") is not None:
        return FrameBudget(target["frames"])
    return None if target.get("seconds") is None else TimeBudget(target["seconds"])


def run_length(
    kernel: Any,
    info: KernelInfo,
    chains: int,
    iterations: int | None,
    budget: Budget | FrameBudget | TimeBudget | None,
    n_frames: int,
) -> Length:
    """Return the length of a run.

    Args:
        kernel: as made for the event.
        info: what is known of it.
        chains: number of particles.
        iterations, budget: as the user gave them.
        n_frames: of a complete simulation.

    Raises:
        InvalidSettingError: both are given, or they are not what the kernel can do.
    """
    if budget is not None and iterations is not None:
        raise InvalidSettingError("give either iterations or a budget, not both")
    if not isinstance(budget, Budget | FrameBudget | TimeBudget | None):
        raise InvalidSettingError(
            f"budget={shown(budget)}, expected phase_ppl.simulations(n), phase_ppl.frames(n) or "
            "phase_ppl.seconds(n)"
        )
    length = Length(
        0,
        getattr(kernel, "sims_at_start", 1),
        getattr(kernel, "sims_per_step", info.sims_per_step),
    )
    own = getattr(kernel, "n_iterations", None)
    if own is not None:
        needed = own(chains)
        _check_own(info.name, length.at_most(chains, needed), needed, chains, iterations, budget,
                   n_frames)  # fmt: skip
        return length._replace(iterations=needed)
    if budget is None:
        wanted = ITERATIONS if iterations is None else whole_number("iterations", iterations)
        return length._replace(iterations=wanted)
    at_start = length.at_most(chains, 0)
    if isinstance(budget, TimeBudget):
        return length._replace(iterations=None, seconds=budget.seconds)
    if isinstance(budget, Budget):
        # what an iteration takes is not known before, but a simulation for each particle is little
        if budget.simulations < at_start + chains:
            raise InvalidSettingError(
                f"a budget of {budget.simulations} simulations is too small: {chains} initial "
                f"particles and one iteration need {at_start + chains}"
            )
        return length._replace(iterations=None, simulations=budget.simulations)
    if budget.frames <= at_start * n_frames:
        raise InvalidSettingError(
            f"a budget of {budget.frames} frames is too small: {chains} initial particles need "
            f"{at_start * n_frames}, and iterations come on top"
        )
    return length._replace(iterations=None, frames=budget.frames)


def _check_own(
    name: str,
    simulations: int,
    needed: int,
    chains: int,
    iterations: int | None,
    budget: Budget | FrameBudget | TimeBudget | None,
    n_frames: int,
) -> None:
    """Raise InvalidSettingError if something contradicts a kernel that decides its own length."""
    if isinstance(budget, TimeBudget):
        raise InvalidSettingError(
            f"a budget of seconds is of no use to kernel {name!r}: with {chains} chains it takes "
            f"{needed} iterations, whatever their time"
        )
    if iterations is not None and iterations != needed:
        raise InvalidSettingError(
            f"iterations={iterations}, but kernel {name!r} decides itself: with {chains} chains "
            f"it takes {needed}; leave iterations out"
        )
    if isinstance(budget, Budget) and budget.simulations < simulations:
        raise InvalidSettingError(
            f"a budget of {budget.simulations} simulations is too small: kernel {name!r} takes "
            f"{simulations}"
        )
    if isinstance(budget, FrameBudget) and budget.frames < simulations * n_frames:
        raise InvalidSettingError(
            f"a budget of {budget.frames} frames is too small: kernel {name!r} takes "
            f"{simulations * n_frames}"
        )


def check_chains(info: KernelInfo, chains: int) -> None:
    """Raise InvalidSettingError if the kernel cannot work with so many chains."""
    whole_number("chains", chains)
    if info.even_chains and chains % 2:
        raise InvalidSettingError(
            f"chains={chains}: kernel {info.name!r} needs an even number, such as {chains + 1}"
        )
