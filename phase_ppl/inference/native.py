"""NumPyro's own route: the model of an event as a NumPyro program, for NumPyro's ``MCMC``.

:func:`program` opens one with workers that simulate. ``Posterior.from_numpyro`` turns the run into
our posterior. ``infer`` adds budgets, checkpoints, and results that survive Ctrl-C.
"""

from __future__ import annotations

import dataclasses
import functools
import json
from concurrent.futures import Executor
from types import SimpleNamespace, TracebackType
from typing import Any, Final, Self

import jax
import numpy as np
import xarray as xr
from numpy.typing import NDArray

from phase_ppl.analysis.tree import SCHEMA
from phase_ppl.inference.draws import PARTICLE_COLUMNS, particles_of, tree_of
from phase_ppl.inference.guide import Guide, bottom_up_guide
from phase_ppl.inference.registry import KERNELS
from phase_ppl.inference.settings import SimpleSettings, check_event, check_settings
from phase_ppl.inference.tables import bottom_up_tables
from phase_ppl.models.bridge import Record, SimulatorBridge
from phase_ppl.models.likelihood import is_closed_loop
from phase_ppl.models.model import Model
from phase_ppl.models.program import SEED_SITE, EventProgram
from phase_ppl.simulator.runner import Runner
from phase_ppl.world.errors import InvalidSettingError, check_memory, instance_of
from phase_ppl.world.event import Event
from phase_ppl.world.identity import versions

_FRAME_BYTES: Final = 4 * 3 * 4 + 4  # a frame of a draw, of four entities, and its error


class OpenProgram(EventProgram):
    """The model of an event as a NumPyro program, with workers that simulate; see :func:`program`.

    Attributes:
        event: the event.
        settings: settings of SIMPLE, for kernels that propose from windows of the video.
    """

    def __init__(self, event: Event, model: Model, settings: SimpleSettings, runner: Any) -> None:
        scene, observation = event.scene, event.observation
        bound = model.for_sampling().in_world(scene, observation)
        self.event, self.settings = event, settings
        self._runner, self._open = runner, True
        super().__init__(bound, 0, observation.n_frames)
        self._bridge = SimulatorBridge(runner, observation.n_frames, self.space, raises=True)
        self.bridge = self._bridge.handle

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        traceback: TracebackType | None,
    ) -> None:
        self.close()
        failure = self._bridge.failure
        # JAX wraps the simulator's error in one of its own, with the original's name in its text
        if failure is not None and error is not failure and type(failure).__name__ in str(error):
            raise failure from error

    def close(self) -> None:
        """End the workers; the simulations are kept."""
        self._open = False
        self._runner.close()

    @property
    def records(self) -> list[Record]:
        """One record for each simulation so far: sites, errors and more."""
        return self._bridge.records

    @functools.cached_property
    def guide(self) -> Guide:
        """SIMPLE's bottom-up proposal ``guide(window)``, with ``draw``, ``log_prob``, ``whole``."""
        scene, observation = self.event.scene, self.event.observation
        tables = bottom_up_tables(scene, observation, self.settings)
        share = self.settings.prior_share
        return bottom_up_guide(self.model.prior, self.model.sites, tables, prior_share=share)

    def simulate(self, *args: Any, **options: Any) -> jax.Array:
        if not self._open:
            raise InvalidSettingError(
                "the program is closed and can simulate no more: run it within its with block"
            )
        return super().simulate(*args, **options)

    def draws(self, mcmc: Any) -> xr.DataTree:
        """Return the draws of a run of NumPyro's ``MCMC`` on this program, as a posterior's tree.

        ``Posterior.from_numpyro(mcmc)`` calls it.
        """
        columns = self._columns(mcmc)
        chains, n = columns[SEED_SITE].shape
        n_frames = self.n_frames
        check_memory(
            f"{chains} x {n} draws of {n_frames} frames", chains * n * n_frames * _FRAME_BYTES
        )
        sites = self.model.sites
        steps = [
            particles_of(
                SimpleNamespace(
                    z={name: columns[name][:, draw] for name in sites},
                    **{name: columns[name][:, draw] for name in columns if name not in sites},
                )
            )
            for draw in range(n)
        ]
        # iteration and chain of a simulation are unknown here: so draws are counted
        records = [
            dataclasses.replace(one, log_proposal=np.nan, log_again=-np.inf, n_again=0)
            for one in self.records
        ]
        tree = tree_of(self.event, self.model, steps, records)
        tree.attrs = self._attrs(mcmc, chains, n)
        return tree

    def _columns(self, mcmc: Any) -> dict[str, NDArray[Any]]:
        """Return sites, seeds and the kept fields of a state, (chain, draw, ...)."""
        if mcmc.last_state is None or not self.records:
            raise InvalidSettingError("there are no draws yet: call mcmc.run(key) first")
        found = {
            **mcmc.get_extra_fields(group_by_chain=True),
            **mcmc.get_samples(group_by_chain=True),
        }
        if missing := [name for name in self.model.sites if name not in found]:
            raise InvalidSettingError(
                f"the samples lack {', '.join(missing)}: expected a run that samples all sites"
            )
        asked = self.records[0].sites
        columns = {name: np.asarray(found[name], asked[name].dtype) for name in self.model.sites}
        if SEED_SITE not in found:
            raise InvalidSettingError(
                f"the samples lack {SEED_SITE}, the simulator's seed of each draw: add "
                f"extra_fields=('{SEED_SITE}',) to mcmc.run, if the kernel's state has it"
            )
        columns |= {name: np.asarray(found[name]) for name in PARTICLE_COLUMNS if name in found}
        if "accepted" not in columns:  # NumPyro's kernels: accepted if the draw changed
            seed = columns[SEED_SITE]
            columns["accepted"] = np.diff(seed, axis=1, prepend=seed[:, :1]) != 0
        return columns

    def _attrs(self, mcmc: Any, chains: int, n_draws: int) -> dict[str, Any]:
        kernel, scene, runner = mcmc.sampler, self.event.scene, self._runner
        known = {info.factory: info for _, info in KERNELS.items()}
        info = known.get(type(kernel))
        name = info.name if info else type(kernel).__name__
        settings = {
            "kernel": {"name": name},
            "chains": chains,
            "iterations": n_draws,
            "warmup": mcmc.num_warmup,
            "thinning": mcmc.thinning,
            "chain_method": str(mcmc.chain_method),
            "turning": scene.turning,
            "resets_velocity": scene.resets_velocity,
            "simple": dict(vars(self.settings)),
            "model": self.model.fingerprint(),
        }
        cost = {**dataclasses.asdict(runner.statistics), "workers": runner.workers}
        return {
            "event_id": self.event.id,
            "weights": "count",
            "burn_in": 0,
            "schema": SCHEMA,
            "kernel": name,
            "validity": getattr(kernel, "validity", info.validity if info else "unknown"),
            "settings": json.dumps(settings, default=repr),
            "cost": json.dumps(cost),
            "versions": json.dumps(versions()),
        }


def program(
    event: Event,
    model: Model | None = None,
    *,
    settings: SimpleSettings | None = None,
    workers: int | None = None,
    executor: Executor | None = None,
    on_failure: str = "reject",
    simulation_seconds: float | None = None,
) -> OpenProgram:
    """Return the paper's model of an event as a NumPyro program, with workers that simulate.

    >>> with ppl.program(event, workers=2) as program:
    ...     kernel = ppl.kernels.LocalMH(program)
    ...     mcmc = MCMC(kernel, num_warmup=100, num_samples=200, num_chains=15,
    ...                 chain_method="vectorized")
    ...     mcmc.run(random.key(0))
    >>> post = ppl.Posterior.from_numpyro(mcmc)

    Calling the returned program samples the simulator's seed and the prior's sites, simulates by
    ``jax.pure_callback``, and adds the log likelihood as a ``numpyro.factor``. Vectorised chains
    simulate together.

    The simulator's seed is a sample site, ``sim_seed``. So the same hypothesis and seed always have
    the same likelihood (pseudo-marginal).

    JAX wraps an error or Ctrl-C within a simulation; the ``with`` block raises the original.

    Args:
        event: the event, not a file's name.
        model: prior, simulator and likelihood; by default the paper's. A model with the closed
            loop's likelihood (``ClosedLoopLikelihood``) is refused, since it simulates nothing.
        settings: settings of SIMPLE, for kernels that propose from windows of the video; by default
            those of the preset "simple".
        workers, executor, on_failure, simulation_seconds: as in :func:`phase_ppl.infer`.

    Raises:
        InvalidEventError: ``event`` is no event.
        InvalidSettingError, UnknownNameError: a setting cannot be used.
    """
    check_event(event)
    model = Model() if model is None else model
    settings = SimpleSettings() if settings is None else settings
    instance_of("model", model, Model, "a phase_ppl.Model")
    check_settings(settings)
    if is_closed_loop(model.likelihood):
        raise InvalidSettingError(
            "the closed loop's likelihood simulates nothing: write phase_ppl.infer(event, model)"
        )
    runner = Runner(
        model.build_simulator(),
        event.scene,
        event.observation,
        workers=workers,
        executor=executor,
        on_failure=on_failure,
        simulation_seconds=simulation_seconds,
    )
    return OpenProgram(event, model, settings, runner)
