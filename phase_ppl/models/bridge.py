"""The bridge from kernels to the simulator: one call for all particles."""

from __future__ import annotations

import dataclasses
import functools
import itertools
import math
import threading
import weakref
from collections.abc import Mapping
from typing import Any, Final, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from numpy.typing import NDArray

from phase_ppl.models.density import NO_DENSITY
from phase_ppl.simulator.contract import SimulationResult
from phase_ppl.world.errors import InvalidSettingError
from phase_ppl.world.scene import PHASE
from phase_ppl.world.space import HypothesisSpace, space_of

_Columns = dict[str, NDArray[Any]]


class Request(NamedTuple):
    """A request for a simulation, or an array (...) of requests.

    Arguments as of :meth:`phase_ppl.models.program.EventProgram.simulate`.
    """

    sites: Mapping[str, Any]
    log_prior: Any
    seed: Any
    error_ceiling: Any = np.inf
    log_proposal: Any = np.nan
    log_bound: Any = np.inf


@dataclasses.dataclass(frozen=True, eq=False)
class Record:
    """One simulation that was run."""

    result: SimulationResult  # what came out
    sites: dict[str, NDArray[Any]]  # all latent sites of the prior, as the chain holds them
    log_prior: float  # their log density
    chain: int  # which particle asked for it
    iteration: int  # in which iteration; 0 for the initial particles
    # log density of the proposal that drew it, given the history of the run; NaN: unknown
    log_proposal: float = math.nan
    # log of its largest possible acceptance ratio, less its log likelihood. It was simulated to the
    # end with probability min(1, exp(log_bound + log likelihood)); inf: with certainty
    log_bound: float = math.inf
    # log of the sum of 1 / proposal density over later requests that it answered; -inf: none
    log_again: float = -math.inf
    n_again: int = 0  # number of these later requests


class SimulatorBridge:
    """Answers kernels' requests for simulations, and keeps a record of them.

    A request is a pure function of its arguments, since the seed is one of them. So JAX may reorder
    requests, and a request with a completed simulation is answered again at no cost. All particles
    of a vectorised step arrive in one call.

    Args:
        runner: simulates, as :class:`phase_ppl.simulator.runner.Runner` does.
        n_frames: of the observation.
        space: the meaning of sites' values; by default PHASE's.
        raises: whether an exception leaves at once, through JAX, instead of waiting.

    Attributes:
        handle: number by which compiled code that calls back knows this bridge.
        records: every simulation so far.
        iteration: label of new records.
        failure: the last exception that ended a call, if any. The code that runs the chain raises
            it; until then all requests get infinite errors. If it were raised at once, JAX would
            log it and replace it by an exception of another class.
    """

    def __init__(
        self,
        runner: Any,
        n_frames: int,
        space: HypothesisSpace | None = None,
        *,
        raises: bool = False,
    ) -> None:
        self.handle = next(_handles)
        self.records: list[Record] = []
        self.iteration = 0
        self.failure: BaseException | None = None
        self._runner = runner
        self._n_frames = n_frames
        self._space = space_of(PHASE) if space is None else space
        self._raises, self._one_call = raises, threading.Lock()
        self._completed: dict[tuple[Any, ...], int] = {}  # request -> row of the records
        _open[self.handle] = self

    def answer(self, request: Request, n_frames: int | None = None) -> NDArray[np.float32]:
        """Return the errors (..., time) of an array (...) of requests, one of particles first.

        In arrays of ``n_frames``, by default those of the observation; 0 beyond its end.
        """
        # NumPy from the first line on: calling JAX from inside compiled code can deadlock
        sites = {name: np.asarray(values) for name, values in request.sites.items()}
        batch = np.shape(request.seed)
        numbers = [np.broadcast_to(np.asarray(one), batch) for one in request[1:]]
        found = np.full((*batch, self._n_frames), np.inf, np.float32)
        if self.failure is None or self._raises:
            try:
                with self._one_call:  # chains may run in threads
                    found = self._simulate(sites, *numbers)
            except BaseException as error:
                self.failure = error
                if self._raises:
                    raise
        beyond = 0 if n_frames is None else n_frames - self._n_frames
        return np.pad(found, [(0, 0)] * len(batch) + [(0, beyond)])

    def remember(self, record: Record) -> None:
        """Keep a simulation; if it completed, it answers the same request from now on."""
        if record.result.completed:
            self._completed[request_key(record.sites, record.result.seed)] = len(self.records)
        self.records.append(record)

    def _simulate(self, columns: _Columns, *numbers: NDArray[Any]) -> NDArray[np.float32]:
        batch = numbers[1].shape
        log_prior, seed, *rest = map(np.ravel, numbers)
        ceiling, log_proposal, log_bound = (one.astype(np.float32) for one in rest)
        n_rows = len(seed)
        rows_per_chain = n_rows // batch[0] if batch else 1
        flat = {k: v.reshape(n_rows, *v.shape[len(batch) :]) for k, v in columns.items()}
        errors = np.full((n_rows, self._n_frames), np.inf, np.float32)
        asked: dict[tuple[Any, ...], list[int]] = {}  # request -> its rows of this batch
        # a density that is no number: outside
        inside = (log_prior > NO_DENSITY) & self._space.in_support(flat)
        for row in np.flatnonzero(inside).tolist():
            sites = {name: values[row] for name, values in flat.items()}
            key = request_key(sites, int(seed[row]))
            known = self._completed.get(key)
            if known is None:
                asked.setdefault(key, []).append(row)
            else:
                errors[row] = self.records[known].result.errors
                self._ask_again(known, float(log_proposal[row]))
        # of equal requests the one with the highest ceiling is run, and answers all
        rows = [max(alike, key=lambda row: ceiling[row]) for alike in asked.values()]
        results = self._runner.run(
            [self._space.hypothesis({k: v[row] for k, v in flat.items()}) for row in rows],
            [int(seed[row]) for row in rows],
            [float(ceiling[row]) for row in rows],
        )
        for alike, longest, result in zip(asked.values(), rows, results, strict=True):
            errors[alike] = result.errors
            # the first that would have completed answers the later ones, as in batches of one
            ends = [r for r in alike if result.completed and result.total_error <= ceiling[r]]
            row = ends[0] if ends else longest
            if result.completed and not ends:
                # its last frame exceeded the ceiling: one frame earlier it would have been stopped
                result = dataclasses.replace(result, completed=False)
            sites = {name: values[row] for name, values in flat.items()}
            place = len(self.records)
            self.remember(
                Record(
                    result,
                    sites,
                    log_prior=float(log_prior[row]),
                    chain=row // rows_per_chain,
                    iteration=self.iteration,
                    log_proposal=float(log_proposal[row]),
                    log_bound=float(log_bound[row]),
                )
            )
            for other in alike:
                if other > row or (other < row and not ends):
                    self._ask_again(place, float(log_proposal[other]))
        return errors.reshape(*batch, self._n_frames)

    def _ask_again(self, place: int, log_proposal: float) -> None:
        """Count one more request that a record answers."""
        if not math.isnan(log_proposal):
            record = self.records[place]
            log_again = float(np.logaddexp(record.log_again, -log_proposal))
            n_again = record.n_again + 1
            self.records[place] = dataclasses.replace(record, log_again=log_again, n_again=n_again)


_handles: Final = itertools.count()
_open: Final[weakref.WeakValueDictionary[int, SimulatorBridge]] = weakref.WeakValueDictionary()


def _answered(handle: Any, request: Request, n_frames: int) -> NDArray[np.float32]:
    return _open[int(np.asarray(handle).flat[0])].answer(request, n_frames)


@functools.partial(jax.custom_jvp, nondiff_argnums=(0,))
def called_back(n_frames: int, handle: jax.Array, request: Request) -> jax.Array:
    """Return (..., time) the errors from a handle's bridge, inside compiled code.

    All particles of a vectorised program are one call.
    """
    errors = jax.ShapeDtypeStruct((*jnp.shape(request.seed), n_frames), np.float32)
    host = functools.partial(_answered, n_frames=n_frames)
    return jax.pure_callback(host, errors, handle, request, vmap_method="broadcast_all")


@called_back.defjvp
def no_gradient(*_: Any) -> Any:
    """Raise InvalidSettingError: a simulation has no gradient."""
    raise InvalidSettingError(
        "a simulation has no gradient, which this sampler asks for: take a kernel of "
        "phase_ppl.kernels, or one without gradients, such as NumPyro's SA or AIES"
    )


def request_key(sites: Mapping[str, NDArray[Any]], seed: int) -> tuple[Any, ...]:
    """Return the key of a request: seed and sites, to the last bit."""
    return seed, *(sites[name].tobytes() for name in sorted(sites))
