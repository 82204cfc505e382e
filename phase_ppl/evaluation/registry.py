"""Registry of models of social perception: ours, in ``evaluation/models``, and other packages'.

Another package registers its model under the entry point group ``phase_ppl.models``::

    [project.entry-points."phase_ppl.models"]
    my_model = "my_package.my_model:my_model"

where ``my_model`` is a function decorated with :func:`register_model`. It is called once, with
the options that a user gives, and returns the model itself: ``predict(scene, observation, seed)``
(:data:`Predict`). The model is pickled and sent to worker processes. So large data are best loaded
at the first prediction.
"""

from __future__ import annotations

import dataclasses
import importlib.util
import inspect
import os
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final, NamedTuple, Protocol, Self, TypeAlias

import phase_ppl
from phase_ppl.analysis.event_posterior import EventPosterior
from phase_ppl.evaluation.folder import POSTERIOR
from phase_ppl.evaluation.prediction import Prediction
from phase_ppl.world.errors import InvalidSettingError, shown
from phase_ppl.world.event import Observation
from phase_ppl.world.identity import qualified_name, source_hash, stable
from phase_ppl.world.picture import plain
from phase_ppl.world.registry import Registry
from phase_ppl.world.scene import Scene, World, check_is_phase

if TYPE_CHECKING:
    from phase_ppl.analysis.hypotheses import Hypotheses
    from phase_ppl.models.model import Model

Given: TypeAlias = Prediction | EventPosterior | Mapping[str, Any]
"""An answer: a prediction (its event id is ignored), a posterior, or a mapping from questions. A
question is mapped to a label, to label -> probability, or to probabilities in label order; a
question without an answer is absent, or None. PHASE's questions are "goal_red", "goal_green" and
"relation"; other worlds have those of :func:`~phase_ppl.evaluation.prediction.questions_of`."""


class Answer(NamedTuple):
    """A model's answer with files that belong to it.

    Attributes:
        given: the answer: a prediction, a posterior, or a mapping from questions, as
            :meth:`phase_ppl.Prediction.of` takes it.
        artefacts: name of a file -> a function that writes this file to the path it is given.
        posterior: the model's posterior, if it has one, for an observer (:class:`Onlooker`).
    """

    given: Given
    artefacts: Mapping[str, Callable[[Path], object]] = {}
    posterior: Hypotheses | None = None

    @classmethod
    def of(cls, given: object) -> Self:
        """Return what a model gave as an answer; a posterior is also kept as a file."""
        if isinstance(given, cls):
            return given
        if isinstance(given, EventPosterior):
            return cls(given, {POSTERIOR: given.save}, given)
        return cls(given)  # type: ignore[arg-type]


Predict: TypeAlias = Callable[[Scene, Observation, int], Given | Answer]
"""A model, ready to be asked: ``predict(scene, observation, seed)``. It gets nothing else of an
event. The same three arguments give the same answer.

It may have two methods. ``warm_up()`` is called once before the first event, to prepare data that
all processes share, such as compiled code on disk. ``settings()`` returns, as plain data, all else
that determines its answers."""

Factory = Callable[..., Predict]  # ``factory(**options)`` checks the options and returns the model


@dataclasses.dataclass(frozen=True)
class ModelInfo:
    """What is known of a model before it is made.

    Attributes:
        name: the model's name, as users call it.
        factory: function ``factory(**options)`` that checks the options and returns the model: a
            function ``(scene, observation, seed)``.
        summary: first line of the factory's documentation.
        parallel, needs, extra, any_world: the arguments of
            :func:`phase_ppl.register_model`.
    """

    name: str
    factory: Factory
    summary: str
    parallel: bool = True
    needs: tuple[str, ...] = ()
    extra: str | None = None
    any_world: bool = False

    def make(self, **options: Any) -> Predict:
        """Return the model with these options.

        Raises:
            InvalidSettingError: an option is unknown, missing or invalid, or a module is not
                installed.
        """
        if missing := not_installed(self.needs, self.extra):
            raise InvalidSettingError(f"model {self.name!r} needs {missing}")
        try:
            inspect.signature(self.factory).bind(**options)
        except TypeError as error:
            raise InvalidSettingError(f"model {self.name!r}: {error}") from None
        return self.factory(**options)


MODELS: Final = Registry[ModelInfo](
    "model", package="phase_ppl.evaluation.models", entry_points="phase_ppl.models"
)


def register_model(
    name: str,
    *,
    parallel: bool = True,
    needs: Sequence[str] = (),
    extra: str | None = None,
    any_world: bool = False,
) -> Callable[[Factory], Factory]:
    """Return a decorator that registers a factory of models under ``name``.

    The factory is a function ``factory(**options)`` that returns a model: a function
    ``(scene, observation, seed)``. The model returns a :class:`phase_ppl.Prediction`, a posterior,
    or a mapping of answers, as :meth:`phase_ppl.Prediction.of` takes it. The first line of the
    factory's documentation describes the model.

    Args:
        name: name by which users call the model.
        parallel: whether several processes may run the model in parallel.
        needs: modules that must be installed beside those that the package itself needs.
        extra: the extra of this package that installs them; None: no extra does.
        any_world: whether the model may be asked about events of other worlds than PHASE.

    Raises:
        InvalidSettingError: the name is taken by another factory.
    """
    return MODELS.register(
        name,
        lambda factory, summary: ModelInfo(
            name, factory, summary, parallel, tuple(needs), extra, any_world
        ),
    )


def available_models() -> list[str]:
    """Return the names of all models, sorted."""
    return MODELS.names()


def model_info(name: str) -> ModelInfo:
    """Return what is known of a registered model: its factory, summary, needs and so on.

    Raises:
        UnknownNameError: there is no such model; the message names close matches.
    """
    return MODELS[name]


def not_installed(needs: Sequence[str], extra: str | None) -> str | None:
    """Return which of the modules are missing, and how to install them; None: they are there."""
    missing = [module for module in needs if not is_installed(module)]
    how = f": pip install 'phase_ppl[{extra}]'" if extra else ""
    return f"{', '.join(missing)}, which is not installed{how}" if missing else None


def check_world(model: object, world: World) -> None:
    """Raise InvalidSettingError where a model given by name knows PHASE only, not ``world``."""
    if isinstance(model, str) and not model_info(model).any_world:
        check_is_phase(world, f"model {model!r}")


def is_installed(module: str) -> bool:
    """Return whether a module is there, without importing it."""
    try:
        return importlib.util.find_spec(module) is not None
    except ModuleNotFoundError:  # of a submodule whose package is missing
        return False


@dataclasses.dataclass(frozen=True, eq=False)
class ReadyModel:
    """A model that is made, and what is known of it."""

    name: str  # as reports call it
    predict: Predict  # the model
    parallel: bool  # whether several processes may run it
    registered: bool  # whether it was given by name
    record: Mapping[str, Any]  # what determines its answers, as plain data


def ready(model: str | Model | Predict, options: Mapping[str, Any]) -> ReadyModel:
    """Return a model given by name with its options, or as a callable, ready to be asked.

    A :class:`phase_ppl.Model` is explained as by :func:`phase_ppl.infer`: by the closed loop, or
    sampled where the options name a kernel or a preset.
    """
    if not isinstance(model, str) and not callable(model):
        from phase_ppl.models.model import Model

        if not isinstance(model, Model):
            raise InvalidSettingError(
                f"model={shown(model)} is neither a name, a phase_ppl.Model nor a function "
                "(scene, observation, seed)"
            )
        samples = not {"kernel", "preset"}.isdisjoint(options)
        model, options = "simple" if samples else "closed_loop", {"program": model, **options}
    source: Callable[..., Any]
    if isinstance(model, str):
        info = model_info(model)
        predict, name, parallel, source = info.make(**options), model, info.parallel, info.factory
    else:
        if options:
            raise InvalidSettingError(
                f"{', '.join(options)}: options are for models given by name, not for {model!r}"
            )
        name = getattr(model, "__name__", type(model).__name__)
        predict, parallel, source = model, True, model
    details = getattr(predict, "settings", dict)
    record = {
        "model": name,
        # functions by name: the text of a partial or of an object would show what it holds
        "options": {
            option: qualified_name(value) if callable(value) else value
            for option, value in options.items()
        },
        "model_settings": details(),
        "function": qualified_name(source),
        "function_source": source_hash(source),
    }
    return ReadyModel(name, predict, parallel, isinstance(model, str), stable(plain(record)))


class Onlooker(Protocol):
    """An observer: it turns a model's answers into the answers of a person who watches.

    This is a protocol: an observer of your own is an object of any class with these two members.

    Attributes:
        record: a mapping of plain data with all settings of the observer. In an evaluation's
            settings it is merged with the model's. So none of its keys may be one of theirs:
            "model", "options", "model_settings", "function", "function_source", "seed", "versions"
            or "events".
    """

    @property
    def record(self) -> Mapping[str, Any]: ...

    def seeing(self, model: Predict, world: World) -> Predict:
        """Return ``model``, changed to answer as a person who watches events of ``world``.

        Like the model, it is a function ``(scene, observation, seed)``.
        """


def seen_through(
    model: ReadyModel, observer: str | os.PathLike[str] | Onlooker, world: World
) -> ReadyModel:
    """Return a model seen through an observer; a fitted one may be given by name or as a file."""
    if isinstance(observer, str | os.PathLike):
        observer = phase_ppl.FittedObserver.named(observer, model.name, world)
    record = {**model.record, **observer.record}
    return dataclasses.replace(model, predict=observer.seeing(model.predict, world), record=record)
