"""The kernels of a comparison: what they are called, how they run, whether they can."""

from __future__ import annotations

import dataclasses
from collections import Counter
from collections.abc import Iterable, Mapping
from concurrent.futures import Executor
from typing import Any, Final, TypeAlias

from phase_ppl.analysis.posterior import Posterior
from phase_ppl.inference.infer import infer
from phase_ppl.inference.registry import KernelInfo, info_of
from phase_ppl.inference.run import Kernel, Run
from phase_ppl.inference.settings import PRESETS, SimpleSettings, completed
from phase_ppl.models.model import Model
from phase_ppl.world.errors import InvalidSettingError, PhasePPLError, instance_of, shown
from phase_ppl.world.event import Event

Spec: TypeAlias = Kernel | tuple[Kernel, Mapping[str, Any]]  # A kernel, or a kernel and its options

_TAKEN: Final = (
    *("event", "model", "kernel", "seed", "workers", "executor", "progress", "planner"),
    *("budget", "iterations", "checkpoint"),
)
"""Arguments of ``infer`` that are the comparison's to give."""


@dataclasses.dataclass(frozen=True, eq=False)
class Entry:
    """A kernel that is compared."""

    label: str  # what it is called in tables and figures
    kernel: Kernel  # as ``infer`` takes it
    options: Mapping[str, Any]  # of the kernel
    chains: int  # particles M
    settings: SimpleSettings  # of SIMPLE
    length: Mapping[str, Any]  # ``budget`` or ``iterations`` where they are not the comparison's
    info: KernelInfo  # what is known of the kernel

    def record(self) -> dict[str, Any]:
        """Return name and options as a file keeps them."""
        return {
            "name": self.info.name,
            "options": dict(self.options),
            "chains": self.chains,
            "settings": dataclasses.asdict(self.settings),
            **({"length": {k: str(v) for k, v in self.length.items()}} if self.length else {}),
        }

    def check(self, event: Event, model: Model, budget: Any) -> None:
        """Make the kernel and trace a step of it, with nothing simulated."""
        try:
            length = self.length or {"budget": budget}
            run = Run(event, model, self.kernel, self.options, self.settings, self.chains, seed=0)
            run.check(length.get("iterations"), length.get("budget"))
        except PhasePPLError as error:
            raise type(error)(f"{self.label}: {error}") from None
        except Exception as error:  # whatever a kernel of somebody's stumbles over
            reason = " ".join(str(error).split())
            raise InvalidSettingError(
                f"{self.label}: the kernel cannot run with {self.chains} chains and these "
                f"settings: {type(error).__name__}: {reason}"
            ) from error

    def run(
        self,
        event: Event,
        model: Model,
        budget: Any,
        seed: int,
        workers: int | None,
        executor: Executor | None = None,
    ) -> Posterior:
        """Return the posterior of one run."""
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
            **self.options,
        )


def entry_of(
    label: str | None, spec: Spec, chains: int, settings: SimpleSettings, own_length: bool = False
) -> Entry:
    """Return the kernel that a user names, called ``label`` or by its name.

    Its options may have ``chains`` and ``settings`` of their own and, with ``own_length``, a budget
    or iterations.
    """
    kernel, given = spec if isinstance(spec, tuple) and len(spec) == 2 else (spec, {})
    if isinstance(kernel, tuple) or not isinstance(given, Mapping):
        raise InvalidSettingError(
            f"{shown(spec)} is no kernel: expected a name, a kernel class, or (name, options)"
        )
    options = dict(given)
    if isinstance(kernel, str) and kernel in PRESETS:
        label = label or kernel
        options = {"kernel": "local_mh", **completed(kernel, options)}
        kernel = str(options.pop("kernel"))
        for name in ("planner", "weights", "iterations"):  # the same for all kernels
            options.pop(name, None)
    info = info_of(kernel)
    own_lengths = ("budget", "iterations") if own_length else ()
    length = {name: options.pop(name) for name in own_lengths if name in options}
    for name in options:
        if name in _TAKEN:
            raise InvalidSettingError(
                f"kernel {info.name!r}: {name} is the same for all kernels; give it to compare()"
            )
    own = options.pop("settings", settings)
    if not isinstance(own, SimpleSettings):
        raise InvalidSettingError(f"settings={shown(own)}, expected SimpleSettings")
    if own.beta is not None:
        raise InvalidSettingError("beta is the model's here: Model(likelihood=RadialLikelihood(b))")
    own_chains = options.pop("chains", chains)
    return Entry(label or info.name, kernel, options, own_chains, own, length, info)


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
