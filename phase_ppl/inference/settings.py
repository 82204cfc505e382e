"""Settings of SIMPLE, budgets, and presets."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping
from typing import Any, Final, Literal, get_args

from phase_ppl.world.errors import (
    InvalidEventError,
    InvalidSettingError,
    instance_of,
    nonnegative_number,
    number_or_nan,
    positive_number,
    shown,
    unknown_name,
    whole_number,
)
from phase_ppl.world.event import Event
from phase_ppl.world.scene import PHASE, World

Sign = Literal["intended", "printed"]
Unit = Literal["arena", "printed"]
Form = Literal["learned", "paper", "closed_loop"]
Strength = Literal["network", "analytic"]

SIGNS: Final = get_args(Sign)
UNITS: Final = get_args(Unit)
FORMS: Final = get_args(Form)
STRENGTHS: Final = get_args(Strength)


@dataclasses.dataclass(frozen=True)
class SimpleSettings:
    """Settings of SIMPLE; the numbers are the paper's (Appendix 4).

    SIMPLE proposes the next hypothesis from a window, a short interval of the video.

    Attributes:
        eta: how strongly windows in which the simulation has large errors are preferred, 1 / units;
            0: all windows alike.
        proposal: how goals are proposed. "learned": from features of what the agents did, with
            weights learned in PHASE. "paper": from distances alone, with ``gamma``, ``unit`` and
            ``sign``. "closed_loop": from the closed loop's likelihoods of the window's frames; the
            closed loop reads the video once before the first simulation. None: "learned" in PHASE,
            "paper" in other worlds.
        gamma: weight of the distances in the paper's proposal of goals.
        window: length of a window, Delta T, in steps (frames); shorter if the video is shorter.
        unit: divisor of distances in the paper's proposal. "arena": the arena's diagonal.
            "printed": none, so that goals other than the nearest are hardly ever proposed.
        prior_share: share of proposals that are drawn from the prior. With 0, as printed, a
            hypothesis that the windows exclude, such as a strength beyond 150 to 600 N, is never
            tried. So 0 is only for ``rule="paper"``, an option of the kernel.
        sign: sign of the distances in the paper's proposal. "intended": goals that are close are
            proposed. "printed": the paper's formula, which proposes goals that are far.
        strength: how strengths are proposed. "network": by a network trained in PHASE. "analytic":
            by a rule for any world. None: the network in PHASE, the rule elsewhere.

    Raises:
        InvalidSettingError: a value is out of range, or goes with another proposal.
        UnknownNameError: ``proposal``, ``unit``, ``sign`` or ``strength`` is unknown.
    """

    eta: float = 0.1
    proposal: Form | None = None
    gamma: float = 10.0
    window: int = 10
    unit: Unit = "arena"
    prior_share: float = 0.1
    sign: Sign = "intended"
    strength: Strength | None = None

    def __post_init__(self) -> None:
        for name in ("eta", "gamma"):
            nonnegative_number(name, getattr(self, name))
        if not 0 <= number_or_nan(self.prior_share) < 1:
            raise InvalidSettingError(
                f"prior_share={shown(self.prior_share)}, expected a number in [0, 1)"
            )
        whole_number("window", self.window)
        for name, known in (
            *(("sign", SIGNS), ("unit", UNITS)),
            *(("proposal", (*FORMS, None)), ("strength", (*STRENGTHS, None))),
        ):
            if getattr(self, name) not in known:
                raise unknown_name(name, getattr(self, name), filter(None, known))
        own = {name: getattr(self, name) for name in ("gamma", "unit", "sign")}
        changed = [f"{k}={v!r}" for k, v in own.items() if v != getattr(SimpleSettings, k)]
        if changed and self.proposal != "paper":
            raise InvalidSettingError(
                f"{', '.join(changed)}: settings of proposal='paper'; give that with them"
            )

    def settled(self, world: World) -> SimpleSettings:
        """Return the settings with the None of proposal and strength replaced by a world's values.

        Raises:
            InvalidSettingError: the settings name a part learned in PHASE for another world.
        """
        learned = {"proposal": "learned", "strength": "network"}
        usual = learned if world == PHASE else {"proposal": "paper", "strength": "analytic"}
        for name, value in learned.items():
            if getattr(self, name) == value != usual[name]:
                raise InvalidSettingError(
                    f"{name}={value!r} was learned in PHASE and knows no other world, such as "
                    f"{world.name!r}: expected SimpleSettings({name}={usual[name]!r})"
                )
        none = {name: value for name, value in usual.items() if getattr(self, name) is None}
        return dataclasses.replace(self, **none)  # type: ignore[arg-type]


def check_settings(given: object) -> None:
    """Raise InvalidSettingError unless these are settings."""
    instance_of("settings", given, SimpleSettings, "a phase_ppl.SimpleSettings")


def check_event(given: object) -> Event:
    """Return ``given`` if it is an event; raise InvalidEventError otherwise."""
    if not isinstance(given, Event):
        raise InvalidEventError(f"{shown(given)} is no event; phase_ppl.load_event reads one")
    return given


BUDGETS: Final = "phase_ppl.simulations(n), phase_ppl.frames(n) or phase_ppl.seconds(n)"


@dataclasses.dataclass(frozen=True)
class Budget:
    """Limit on the cost of a run: ``amount`` of ``unit`` "simulations", "frames" or "seconds"."""

    amount: float
    unit: Literal["simulations", "frames", "seconds"]

    def __str__(self) -> str:
        return f"{self.amount} {self.unit}"


def simulations(n: int) -> Budget:
    """Return a budget of ``n`` simulations, the initial ones included.

    Only simulations that were run count. A proposal without prior mass, or one whose simulation was
    stored earlier in the run, costs nothing. A simulation stopped early counts as one. An iteration
    that has begun is finished, so a run may exceed the budget by one iteration of all particles.

    Raises:
        InvalidSettingError: ``n`` is no whole number >= 1.
    """
    return Budget(whole_number("simulations", n), "simulations")


def frames(n: int) -> Budget:
    """Return a budget of ``n`` simulated frames, those of the initial particles included.

    Only frames that were simulated count. So a kernel that stops simulations early gets more
    simulations. An iteration that has begun is finished, as under :func:`simulations`. The number
    of iterations depends on the states of the chains: this biases the mean over runs a little, less
    the longer the runs are.

    Raises:
        InvalidSettingError: ``n`` is no whole number >= 1.
    """
    return Budget(whole_number("frames", n), "frames")


def seconds(n: float) -> Budget:
    """Return a budget of ``n`` seconds of wall time, from the start of the call.

    The initial particles are always simulated, unless one takes longer than the whole budget. If
    the closed loop proposes goals, it reads the video first. This time counts; an earlier reading
    that is used again takes none. An iteration begins only if, judging by earlier iterations, it
    will end in time. So a run often takes less time than the budget and rarely more. An iteration
    is stopped once the run has taken 1.1 ``n`` + 1 seconds.

    Raises:
        InvalidSettingError: ``n`` is no positive number.
    """
    return Budget(positive_number("seconds", n), "seconds")


# --- SIMPLE in one word ---------------------------------------------------------------------------

KERNEL: Final = "local_mh"
"""The kernel that is SIMPLE."""

_OF_THE_PAPER: Final = {
    "kernel": KERNEL,
    "planner": "as_printed",
    "weights": "count",
    "chains": 15,
    "iterations": 6,
}

PRESETS: Final[Mapping[str, Mapping[str, Any]]] = {
    # Appendices 3 and 4 to the letter. Sign and ratio seem to be misprints: far goals are proposed,
    # and the stationary law is not the posterior
    "as_printed": {
        **_OF_THE_PAPER,
        "settings": SimpleSettings(
            proposal="paper", sign="printed", unit="printed", prior_share=0.0
        ),
        "rule": "paper",
    },
    # with the sign that the paper's text describes, and Hastings' exact ratio, which needs Q > 0
    "as_intended": {
        **_OF_THE_PAPER,
        "settings": SimpleSettings(proposal="paper", unit="printed"),
        "rule": "exact",
    },
    # this package's SIMPLE: exact rule, its own bottom-up proposals, fast planner
    "simple": {"kernel": KERNEL},
    # the same, but the closed loop reads the video first and proposes goals
    "guided": {"kernel": KERNEL, "settings": SimpleSettings(proposal="closed_loop")},
}
"""Name -> arguments of :func:`phase_ppl.infer`."""

SETTINGS: Final = tuple(field.name for field in dataclasses.fields(SimpleSettings))
"""Names of SIMPLE's settings, which :func:`completed` takes one by one too."""

_OF_ITS_KERNEL: Final = ("kernel", "rule", "weights", "iterations", "chains")


def preset(name: str) -> dict[str, Any]:
    """Return a preset of SIMPLE: arguments of :func:`phase_ppl.infer` and of the model "simple".

    >>> ppl.infer(event, **ppl.preset("as_printed"))
    >>> ppl.evaluate(events, "simple", preset="as_intended")

    Args:
        name: "simple", "guided", "as_printed" or "as_intended"; the documentation's page of
            deviations lists the differences.

    Raises:
        UnknownNameError: there is no such preset.
    """
    if name not in PRESETS:
        raise unknown_name("preset", name, PRESETS)
    return dict(PRESETS[name])


def completed(name: str, given: Mapping[str, Any]) -> dict[str, Any]:
    """Return the given arguments that are not None, completed from a preset.

    A given kernel replaces the preset's kernel and its options. A given length replaces its
    iterations. Single settings of SIMPLE, such as ``eta=0.2``, change those of the preset.
    """
    usual = preset(name)
    told = {argument: value for argument, value in given.items() if value is not None}
    if told.get("kernel", usual.get("kernel")) != usual.get("kernel"):
        usual = {name: v for name, v in usual.items() if name not in _OF_ITS_KERNEL}
    if not {"budget", "iterations"}.isdisjoint(told):
        usual.pop("iterations", None)
    single = {argument: told.pop(argument) for argument in SETTINGS if argument in told}
    if single and "settings" in told:
        raise InvalidSettingError(f"give either settings or {', '.join(single)}")
    if single:
        settings = usual.get("settings", SimpleSettings())
        told["settings"] = dataclasses.replace(settings, **single)
    return {**usual, **told}
