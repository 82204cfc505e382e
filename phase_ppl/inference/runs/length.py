"""How long a run is and what it may cost, known before anything is simulated."""

from __future__ import annotations

from typing import Any, Final, NamedTuple

from phase_ppl.inference.registry import KernelInfo
from phase_ppl.inference.settings import Budget, TimeBudget
from phase_ppl.world.checks import whole_number
from phase_ppl.world.errors import InvalidSettingError, shown

ITERATIONS: Final = 6
"""L, the paper's number of iterations."""


class Length(NamedTuple):
    """Length of a run.

    Attributes:
        iterations: L, after the initial particles; None: as many as the seconds allow.
        sims_at_start: the most simulations of each initial particle.
        sims_per_step: the most simulations that an iteration takes per particle.
        seconds: of wall time that the run may take; None: any.
    """

    iterations: int | None
    sims_at_start: int
    sims_per_step: int
    seconds: float | None = None

    def simulations(self, chains: int, iterations: int) -> int:
        """Return the most simulations that so many iterations take."""
        return chains * (self.sims_at_start + iterations * self.sims_per_step)


def run_length(
    kernel: Any,
    info: KernelInfo,
    chains: int,
    iterations: int | None,
    budget: Budget | TimeBudget | None,
) -> Length:
    """Return the length of a run.

    Args:
        kernel: as made for the event.
        info: what is known of it.
        chains: number of particles.
        iterations, budget: as the user gave them.

    Raises:
        InvalidSettingError: both are given, or they are not what the kernel can do.
    """
    if budget is not None and iterations is not None:
        raise InvalidSettingError("give either iterations or a budget, not both")
    if not isinstance(budget, Budget | TimeBudget | None):
        raise InvalidSettingError(
            f"budget={shown(budget)}, expected phase_ppl.simulations(n) or phase_ppl.seconds(n)"
        )
    length = Length(
        0,
        getattr(kernel, "sims_at_start", 1),
        getattr(kernel, "sims_per_step", info.sims_per_step),
    )
    own = getattr(kernel, "n_iterations", None)
    if own is not None:
        return _own_length(info.name, length, own(chains), chains, iterations, budget)
    if isinstance(budget, TimeBudget):
        return length._replace(iterations=None, seconds=budget.seconds)
    if budget is None:
        wanted = ITERATIONS if iterations is None else whole_number("iterations", iterations)
    else:
        wanted = budget.iterations(chains, length.sims_per_step, length.sims_at_start)
    return length._replace(iterations=wanted)


def _own_length(
    name: str,
    length: Length,
    needed: int,
    chains: int,
    iterations: int | None,
    budget: Budget | TimeBudget | None,
) -> Length:
    """Return the length that a kernel decides itself, if nothing contradicts it."""
    length = length._replace(iterations=needed)
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
    if budget is not None and budget.simulations < length.simulations(chains, needed):
        raise InvalidSettingError(
            f"a budget of {budget.simulations} simulations is too small: kernel {name!r} takes "
            f"{length.simulations(chains, needed)}"
        )
    return length


def check_chains(info: KernelInfo, chains: int) -> None:
    """Raise InvalidSettingError if the kernel cannot work with so many chains."""
    whole_number("chains", chains)
    if info.even_chains and chains % 2:
        raise InvalidSettingError(
            f"chains={chains}: kernel {info.name!r} needs an even number, such as {chains + 1}"
        )
