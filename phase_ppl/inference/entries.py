"""The kernels of a comparison: their labels, their options, and whether they can run."""

from __future__ import annotations

import dataclasses
from collections import Counter
from collections.abc import Iterable, Mapping
from concurrent.futures import Executor
from typing import TYPE_CHECKING, Any, Final, TypeAlias

from phase_ppl.analysis.posterior import Posterior
from phase_ppl.inference.infer import infer
from phase_ppl.inference.registry import KernelInfo, info_of
from phase_ppl.inference.run import Kernel, Run
from phase_ppl.inference.settings import PRESETS, SimpleSettings, check_settings, completed
from phase_ppl.models.model import Model
from phase_ppl.world.errors import InvalidSettingError, PhasePPLError, instance_of, shown
from phase_ppl.world.event import Event
from phase_ppl.world.scene import World

if TYPE_CHECKING:
    from phase_ppl.analysis.stepwise_posterior import StepwisePosterior

Spec: TypeAlias = Kernel | tuple[Kernel, Mapping[str, Any]]  # A kernel, or a kernel and its options

_TAKEN: Final = (
    *("event", "model", "kernel", "seed", "workers", "executor", "progress", "planner"),
    *("budget", "iterations", "checkpoint", "weights"),
)
"""Arguments of ``infer`` that the comparison itself gives."""

_LENGTHS: Final = ("budget", "iterations")
_OF_PRESETS: Final = ("planner", "weights")


@dataclasses.dataclass(frozen=True, eq=False)
class Entry:
    """A kernel that is compared."""

    label: str  # what it is called in tables and figures
    kernel: Kernel  # as ``infer`` takes it
    options: Mapping[str, Any]  # of the kernel
    chains: int  # particles M
    settings: SimpleSettings  # of SIMPLE
    # ``budget``, ``iterations``, ``planner`` or ``weights`` where they are not the comparison's
    own: Mapping[str, Any]
    info: KernelInfo  # what is known of the kernel

    @property
    def length(self) -> dict[str, Any]:
        """``budget`` or ``iterations``, where these are not the comparison's."""
        return {name: self.own[name] for name in _LENGTHS if name in self.own}

    def proposals(self, world: World) -> str | None:
        """Return how the kernel proposes goals; None: it asks for no proposals."""
        settings = self.settings.settled(world)
        return str(settings.proposal) if "guide" in self.info.needs else None

    def record(self) -> dict[str, Any]:
        """Return name and options as they are stored."""
        return {
            "name": self.info.name,
            "options": dict(self.options),
            "chains": self.chains,
            "settings": dataclasses.asdict(self.settings),
            **({"length": {k: str(v) for k, v in self.length.items()}} if self.length else {}),
            **{name: str(self.own[name]) for name in _OF_PRESETS if name in self.own},
        }

    def check(self, event: Event, model: Model, budget: Any) -> None:
        """Make the kernel and trace one step; nothing is simulated."""
        try:
            length = self.length or {"budget": budget}
            if "planner" in self.own:
                model = dataclasses.replace(model, planner=self.own["planner"])
            run = Run(event, model, self.kernel, self.options, self.settings, self.chains, seed=0)
            run.check(length.get("iterations"), length.get("budget"))
        except PhasePPLError as error:
            raise type(error)(f"{self.label}: {error}") from None
        except Exception as error:  # a user's kernel can raise anything
            reason = " ".join(str(error).split())
            raise InvalidSettingError(
                f"{self.label}: the kernel cannot run with {self.chains} chains and these "
                f"settings: {type(error).__name__}: {reason}"
            ) from error

    def run(
        self,
        event: Event | StepwisePosterior,
        model: Model | None,
        budget: Any,
        seed: int,
        workers: int | None,
        executor: Executor | None = None,
    ) -> Posterior:
        """Return the posterior of one run on an event or on a result of the closed loop."""
        simulates = isinstance(event, Event)
        return infer(
            event,
            model,
            kernel=self.kernel,
            chains=self.chains,
            seed=seed,
            workers=workers,
            executor=executor,
            progress=False,
            settings=self.settings,
            **(self.length or {"budget": budget}),
            planner=self.own.get("planner") if simulates else None,
            **self.options,
        )


def entry_of(
    label: str | None, spec: Spec, chains: int, settings: SimpleSettings, own_length: bool = False
) -> Entry:
    """Return the entry of a kernel that a user names; its label is ``label`` or its name.

    The options may include ``chains`` and ``settings`` and, with ``own_length``, a budget or
    iterations.
    """
    kernel, given = spec if isinstance(spec, tuple) and len(spec) == 2 else (spec, {})
    if isinstance(kernel, tuple) or not isinstance(given, Mapping):
        raise InvalidSettingError(
            f"{shown(spec)} is no kernel: expected a name, a kernel class, or (name, options)"
        )
    options = dict(given)
    if isinstance(kernel, str) and kernel in PRESETS:
        label = label or kernel
        options = completed(kernel, options)
        kernel = str(options.pop("kernel"))
        # a preset is kept whole
        kept: tuple[str, ...] = (*_LENGTHS, *_OF_PRESETS)
    else:
        kept = _LENGTHS if own_length else ()
    own = {name: options.pop(name) for name in kept if name in options}
    info = info_of(kernel)
    for name in options:
        if name in _TAKEN:
            raise InvalidSettingError(
                f"kernel {info.name!r}: {name} is the same for all kernels; give it to compare()"
            )
    own_settings = options.pop("settings", settings)
    check_settings(own_settings, with_beta=False)
    own_chains = options.pop("chains", chains)
    return Entry(label or info.name, kernel, options, own_chains, own_settings, own, info)


def entries(
    kernels: Iterable[Spec] | Mapping[str, Spec], chains: int, settings: SimpleSettings
) -> list[Entry]:
    """Return the kernels of a comparison."""
    if isinstance(kernels, str):
        kernels = [kernels]
    instance_of("kernels", kernels, Iterable, "names, or a mapping from labels to kernels")
    named: Iterable[tuple[str | None, Spec]] = (
        list(kernels.items()) if isinstance(kernels, Mapping) else [(None, k) for k in kernels]
    )
    found = [entry_of(label, spec, chains, settings) for label, spec in named]
    if not found:
        raise InvalidSettingError("kernels is empty: name at least one")
    label, most = Counter(one.label for one in found).most_common(1)[0]
    if most > 1:
        raise InvalidSettingError(
            f"two kernels are called {label!r}: give a mapping from labels to kernels"
        )
    return found
