"""A model: the prior, the simulator and the likelihood that explain an event."""

from __future__ import annotations

import dataclasses
import functools
from collections.abc import Mapping
from typing import TYPE_CHECKING, Any, Final

import jax
import jax.numpy as jnp
import numpy as np
import numpyro.distributions as dist
from jax import random

from phase_ppl.models import priors
from phase_ppl.models.density import (
    NO_DENSITY,
    Program,
    compiled_quickly,
    latent_sites,
    log_density,
    on_cpu,
    remembered,
    site_shapes,
    traced,
)
from phase_ppl.models.effective import BoundPrior, WorldPrior, as_given, space_of_prior
from phase_ppl.models.likelihood import (
    InNats,
    RadialLikelihood,
    TrajectoryLikelihood,
    is_closed_loop,
)
from phase_ppl.models.sites import HYPOTHESIS_SITES
from phase_ppl.models.world_priors import asked, bound, in_one_line, masses_of, refused
from phase_ppl.simulator.contract import goes_on
from phase_ppl.world.errors import InvalidSettingError, shown
from phase_ppl.world.event import Observation
from phase_ppl.world.identity import qualified_name, source_hash
from phase_ppl.world.scene import Scene, World
from phase_ppl.world.space import ALPHA_SITE, HypothesisSpace, space_of

if TYPE_CHECKING:
    from phase_ppl.agents.config import PlannerConfig
    from phase_ppl.models.closed_loop import ClosedLoopLikelihood
    from phase_ppl.simulator.contract import Simulator

DEFAULT_PLANNER: Final = "fast"


@dataclasses.dataclass(frozen=True)
class Model:
    """Prior, simulator and likelihood.

    Attributes:
        prior: NumPyro program that samples the five sites of a hypothesis
            (:mod:`phase_ppl.models.sites`), and perhaps further sites; or the name of a registered
            prior, such as "sparse_social" (:mod:`phase_ppl.models.priors`). For other worlds than
            PHASE the program has one argument, the world (:mod:`phase_ppl.models.world_priors`). A
            prior that looks at the video has arguments named ``scene``, ``observation`` or
            ``event``. Such a prior is empirical, a cue: the video counts twice, in the prior and in
            the likelihood.
        simulator: generator function ``(scene, hypothesis, rng)`` of frames, or an object with the
            methods of :class:`phase_ppl.simulator.contract.Simulator`. None: the joint simulator of
            the paper (Algorithm 1).
        likelihood: object that compares a simulation with the video
            (:class:`phase_ppl.models.likelihood.TrajectoryLikelihood`), or a
            :class:`phase_ppl.ClosedLoopLikelihood`. None: a ``ClosedLoopLikelihood`` for the closed
            loop, a :class:`phase_ppl.RadialLikelihood` for a kernel.
        planner: settings of the joint simulator's planner: "fast", "paper", another name of
            :meth:`phase_ppl.PlannerConfig.named`, or a ``PlannerConfig``. None: "fast".

    Raises:
        InvalidSettingError: the prior cannot work (the message names the site and what is
            expected), or a planner is given for another simulator.
        UnknownNameError: an unknown prior or planner.
    """

    prior: Program = priors.uniform
    simulator: Simulator | None = None
    likelihood: TrajectoryLikelihood | ClosedLoopLikelihood | None = None
    planner: str | PlannerConfig | None = None

    if TYPE_CHECKING:

        def __init__(  # for type checkers: accepts names of priors and simulators without a start
            self,
            prior: Program | str = ...,
            simulator: Any = ...,
            likelihood: TrajectoryLikelihood | ClosedLoopLikelihood | None = ...,
            planner: str | PlannerConfig | None = ...,
        ) -> None: ...

    def __post_init__(self) -> None:
        if isinstance(self.prior, str):
            object.__setattr__(self, "prior", priors.named(self.prior))
        if self.simulator is None:
            object.__setattr__(self, "planner", self.planner_config())
        elif not callable(self.simulator) and not (
            is_closed_loop(self.likelihood) and goes_on(self.simulator)
        ):
            raise InvalidSettingError(
                f"simulator={self.simulator!r}: expected a generator function "
                "(scene, hypothesis, rng) of frames"
            )
        elif self.planner is not None:
            raise InvalidSettingError(
                "planner applies to the joint simulator, but the model has a simulator of its own"
            )
        compares = all(hasattr(self.likelihood, n) for n in ("log_prob", "max_total_error"))
        if self.likelihood is not None and not compares and not is_closed_loop(self.likelihood):
            raise InvalidSettingError(
                f"likelihood={self.likelihood!r} lacks log_prob or max_total_error"
            )
        self.sites  # noqa: B018  (refuses a prior that cannot work, before anything is simulated)

    @functools.cached_property
    def sites(self) -> dict[str, tuple[int, ...]]:
        """Latent sites of the prior: name -> shape. Empty if they depend on the world or video."""
        if asked(self.prior):
            return {}  # its sites depend on the world, or on what is seen
        return dict(checked_sites(self.prior))

    @classmethod
    def realtime(cls, prior: Program | str = priors.uniform) -> Model:
        """Return a model with which the closed loop can read frames as they happen, in any world.

        It has one set of searches, each of 30 simulations over 10 belief particles, one strength
        (450 N) and eight hidden states. Reading costs about an eighth of the usual settings in
        PHASE, and is less accurate; errors of the posterior are unknown. ``benchmarks/realtime.py``
        measures cost and accuracy.

        Args:
            prior: prior of the model, a program or a name.

        Raises:
            InvalidSettingError, UnknownNameError: the prior cannot work, or is unknown.
        """
        from phase_ppl.agents.config import PlannerConfig
        from phase_ppl.closed_loop.hidden_state import Tracking
        from phase_ppl.models.closed_loop import ClosedLoopLikelihood

        tracking = Tracking(strengths=(450.0,), states=8)
        likelihood = ClosedLoopLikelihood(planner_seeds=1, tracking=tracking)
        planner = dataclasses.replace(
            PlannerConfig.named(DEFAULT_PLANNER), simulations=30, particles=10
        )
        return cls(prior, likelihood=likelihood, planner=planner)

    def in_world(self, place: World | Scene, observation: Observation | None = None) -> Model:
        """Return the model for events of a world: the prior and the likelihood are bound to it.

        Args:
            place: the world, or a scene of the world.
            observation: the video of the scene, for a prior that looks at the video.

        Raises:
            InvalidSettingError: the prior is for PHASE and the world is not, or the reverse; the
                prior looks at a scene or video that is not given; or it cannot work.
        """
        prior: Any = bound(self.prior, place, observation)
        likelihood = self.likelihood
        if prior is self.prior:
            return self
        if isinstance(prior, WorldPrior) and type(likelihood) is RadialLikelihood:
            n_entities = len(prior.world.entities)
            likelihood = dataclasses.replace(likelihood, n_entities=n_entities)
        return dataclasses.replace(self, prior=prior, likelihood=likelihood)

    def for_reading(self) -> Model:
        """Return the model with a likelihood for the closed loop: its own, or the default one.

        Raises:
            InvalidSettingError: its likelihood compares whole simulations with the video.
        """
        if is_closed_loop(self.likelihood):
            return self
        if self.likelihood is not None:
            raise InvalidSettingError(
                f"likelihood={shown(self.likelihood)} compares whole simulations with the video, "
                'which takes a kernel that samples: infer(..., kernel="local_mh")'
            )
        from phase_ppl.models.closed_loop import ClosedLoopLikelihood

        return dataclasses.replace(self, likelihood=ClosedLoopLikelihood())

    def for_sampling(self) -> Model:
        """Return the model with a likelihood for kernels: its own, or a ``RadialLikelihood``."""
        if self.likelihood is not None:
            return self
        return dataclasses.replace(self, likelihood=RadialLikelihood())

    @property
    def error_likelihood(self) -> TrajectoryLikelihood:
        """The likelihood that kernels use; it turns the error of each frame into a log density."""
        likelihood: Any = self.for_sampling().likelihood
        return InNats() if is_closed_loop(likelihood) else likelihood

    def planner_config(self) -> PlannerConfig:
        """Return the settings of the joint simulator's planner."""
        from phase_ppl.agents.config import PlannerConfig

        return PlannerConfig.named(DEFAULT_PLANNER if self.planner is None else self.planner)

    def build_simulator(self) -> Simulator:
        """Return the simulator, the joint one with the model's planner by default."""
        if self.simulator is not None:
            return self.simulator
        from phase_ppl.simulator.joint import JointSimulator

        return JointSimulator(self.planner_config())

    def fingerprint(self) -> dict[str, Any]:
        """Return what identifies the model, as plain data for a run's settings.

        Keys are ``prior`` and ``simulator`` (names), ``prior_source`` and ``simulator_source``
        (hashes of the source; None: unknown), ``likelihood`` and ``planner``. If the
        simulator has a method ``settings()``, ``simulator_settings`` is its result.
        """
        users_simulator = self.simulator is not None
        details = getattr(self.simulator, "settings", None)
        return {
            **({"simulator_settings": details()} if callable(details) else {}),
            "prior": qualified_name(as_given(self.prior)),
            "prior_source": source_hash(as_given(self.prior)),
            "simulator": qualified_name(self.simulator) if users_simulator else "joint",
            "simulator_source": source_hash(self.simulator) if users_simulator else None,
            "likelihood": repr(self.likelihood),
            "planner": None if users_simulator else self.planner_config().to_dict(),
        }


# --- whether a prior can work ---------------------------------------------------------------------


def _expected(space: HypothesisSpace) -> dict[str, str]:
    """Return in words what each site of a hypothesis must be."""
    in_phase = space.scenario_names
    statement = ("phase_ppl.sites.{}()" if in_phase else "phase_ppl.roles.{}(world)").format
    return {
        **dict.fromkeys(
            space.goal_sites, f"a goal code, 0..{space.n_goals - 1}, as {statement('goals')}"
        ),
        ALPHA_SITE: f"an alpha code, 0..{len(space.ways) - 1}, as {statement('alpha')}",
        **dict.fromkeys(
            space.strength_sites,
            f"a positive real number, as {statement('strengths')}, or one of a few, as "
            "phase_ppl.sites.OneOf",
        ),
    }


RESERVED_SITES: Final = frozenset(
    (
        *("goal", "relation", "scenario", "stated_goal_red", "stated_goal_green", "weight"),
        *("chain", "draw", "simulation", "time", "entity", "coord", "seed", "iteration"),
        *("log_prior", "log_prior_effective", "log_likelihood", "total_error", "completed"),
        *("frames_simulated", "failed", "mixture", "step_error", "trajectory"),
        *("goal_kind_red", "goal_kind_green", "target_red", "target_green"),
        *("landmark_red", "landmark_green", "sign_red", "sign_green"),
        *("given", "self", "error", "bound", "probability"),
        *("log_joint", "step_log_likelihood", "sim_seed", "uniform"),
    )
)
"""Names that a prior's further sites cannot have."""

_TRIES: Final = 32  # draws that are checked
_REMEMBERED: Final = 64

_NOT_POSITIVE: Final = -np.logspace(-3, 6, 91, dtype=np.float32)
"""Strengths that no support may hold."""

_FAR: Final = 100  # distance from the allowed codes within which others are searched


def for_table(prior: Any, place: World | Scene, observation: Observation | None = None) -> Program:
    """Return a model's prior as :func:`bound`, checked where it can be a table of all there."""
    found = bound(prior, place, observation)
    if isinstance(found, BoundPrior) and space_of(found.world).is_listed:
        checked_sites(found, True)
    return found


@remembered(_REMEMBERED)
@on_cpu()
def checked_sites(prior: Program, as_table: bool = False) -> dict[str, tuple[int, ...]]:
    """Return the latent sites of a prior with their shapes.

    As a table of all hypotheses sites may depend on each other in any world.
    """
    if not callable(prior):
        raise InvalidSettingError(
            f"prior={shown(prior)} is no NumPyro program: expected the name of a ready-made prior "
            f"or a function without arguments that samples {', '.join(HYPOTHESIS_SITES)}"
        )
    given = as_given(prior)
    name = getattr(given, "__name__", shown(given))
    if priors.name_of(given):
        return site_shapes(prior)  # to draw takes seconds, and the tests do
    if isinstance(prior, WorldPrior) and not as_table:
        masses_of(prior)
    try:
        trace = traced(prior, random.key(0))
    except Exception as error:  # a user's program can raise anything
        raise refused(name, f"cannot be run: {in_one_line(error)}") from error
    space = space_of_prior(prior)
    _check_trace(name, trace, space)
    sites = {site: tuple(jnp.shape(s["value"])) for site, s in latent_sites(trace).items()}
    _check_draws(name, prior, sites)
    return sites


def _check_trace(prior: str, trace: Mapping[str, Any], space: HypothesisSpace) -> None:
    """Refuse a prior if a trace has missing or wrong sites."""
    for name, site in trace.items():
        if site["type"] == "sample" and site["is_observed"]:
            raise refused(prior, f"conditions on {name!r} (obs= or factor); a prior only samples")
    latent, expected = latent_sites(trace), _expected(space)
    for name in space.sites:
        if name not in latent:
            raise refused(prior, f"does not sample {name!r}: expected {expected[name]}")
    for name, site in latent.items():
        fault = _fault_of_hypothesis_site(name, site, space) if name in expected else ""
        if fault := fault or _fault(name, site, space):
            raise refused(prior, f"samples {name!r}{fault}")


def _fault_of_hypothesis_site(name: str, site: Mapping[str, Any], space: HypothesisSpace) -> str:
    """Return in words what is wrong with a site of a hypothesis; "" if nothing is."""
    expected = _expected(space)[name]
    if site["cond_indep_stack"]:
        plates = ", ".join(repr(frame.name) for frame in site["cond_indep_stack"])
        return f" in the plate {plates}: expected a single value outside of plates, {expected}"
    shape, dtype = jnp.shape(site["value"]), jnp.result_type(site["value"])
    if shape != ():
        return f" of shape {shape}: expected a single value, {expected}"
    if not _support_fits(site["fn"], space.limits.get(name)):
        return f" with support {site['fn'].support}: expected {expected}"
    if name in space.limits and not jnp.issubdtype(dtype, jnp.integer):
        return f" of type {dtype}: expected {expected}"
    return ""


def _fault(name: str, site: Mapping[str, Any], space: HypothesisSpace) -> str:
    """Return in words what is wrong with any site; "" if nothing is."""
    if name in RESERVED_SITES or (name not in space.sites and name in space.reserved):
        return ", a reserved name"
    if not name or "/" in name:
        return ": expected a name without '/', by which it is stored"
    if isinstance(site["fn"], dist.MaskedDistribution) or site["scale"] not in (None, 1.0):
        plain = "a plain distribution, whose density is that of its draws"
        return f" with a mask or a scale: expected {plain}"
    return ""


def _support_fits(distribution: dist.Distribution, limit: int | None) -> bool:
    """Whether a site has codes below a limit; None: strengths."""
    try:
        support = distribution.support
        if limit is None and support.is_discrete:
            values = np.asarray(distribution.enumerate_support(expand=False))
            possible = values[np.asarray(support(values))]
            return bool(((possible > 0) & np.isfinite(possible)).all())
        if limit is None:
            return not np.asarray(support(_NOT_POSITIVE)).any()
        outside = np.append(np.arange(-_FAR, 0), np.arange(limit, limit + _FAR))
        return support.is_discrete and not np.asarray(support(outside)).any()
    except (NotImplementedError, AttributeError, TypeError, ValueError):
        return False  # a support that cannot be asked, or values that cannot be listed


def _check_draws(name: str, prior: Program, sites: Mapping[str, tuple[int, ...]]) -> None:
    """Draw often, compiled and vectorised as in kernels, and check values and densities."""

    def log_prob(site: str, entry: Mapping[str, Any]) -> jax.Array:
        try:
            return jnp.sum(entry["fn"].log_prob(entry["value"]))
        except Exception as error:
            why = f"which has no density: {in_one_line(error)}; expected a distribution"
            raise refused(name, f"samples {site!r}, {why} with log_prob") from error

    def drawn(key: jax.Array) -> tuple[dict[str, jax.Array], dict[str, jax.Array]]:
        latent = latent_sites(traced(prior, key))
        values = {site: entry["value"] for site, entry in latent.items()}
        return values, {site: log_prob(site, entry) for site, entry in latent.items()}

    keys = random.split(random.key(1), _TRIES)
    try:
        values, by_site = compiled_quickly(jax.vmap(drawn))(keys)
    except InvalidSettingError:
        raise
    except Exception as error:
        expected = "expected jax.numpy throughout, such as jnp.where instead of if"
        raise refused(name, f"cannot be compiled: {in_one_line(error)}; {expected}") from error
    found = {site: jnp.shape(value)[1:] for site, value in values.items()}
    if found != dict(sites):
        differing = sorted(s for s in {*found, *sites} if found.get(s) != sites.get(s))
        raise refused(
            name,
            f"samples {', '.join(map(repr, differing))} in some runs and not, or with another "
            "shape, in others: expected the same sites each time",
        )
    space = space_of_prior(prior)
    for site in space.sites:
        of_site, limit = np.asarray(values[site]), space.limits.get(site)
        if limit is None:
            wrong = ~((of_site > 0) & np.isfinite(of_site))
        else:
            wrong = (of_site < 0) | (of_site >= limit)
        if wrong.any():
            expected = _expected(space)[site]
            raise refused(name, f"draws {site!r} as {of_site[wrong][0]}: expected {expected}")
    for site, densities in by_site.items():
        bad = ~np.isfinite(np.asarray(densities))
        if bad.any():
            at = shown(np.asarray(values[site])[bad][0].tolist())
            raise refused(
                name,
                f"samples {site!r} with a log density of {densities[bad][0]} at a value that it "
                f"drew, {at}: expected a finite number",
            )
    try:
        density = compiled_quickly(jax.vmap(functools.partial(log_density, prior)))(values)
    except Exception as error:
        raise InvalidSettingError(
            f"the density of the prior {name} cannot be evaluated at given values of its sites: "
            f"{in_one_line(error)}"
        ) from error
    if (np.asarray(density) < NO_DENSITY).any():
        raise refused(name, "draws values outside its own support: they have no density")
    total = np.sum([np.asarray(densities) for densities in by_site.values()], axis=0)
    if not np.allclose(density, total, rtol=1e-3, atol=1e-2):
        raise InvalidSettingError(
            f"the density of the prior {name} changes from run to run: expected all randomness to "
            "come from numpyro.sample"
        )
