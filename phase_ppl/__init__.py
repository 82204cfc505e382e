"""phase_ppl: social perception grounded in intuitive physics, as a probabilistic program.

Everything a user needs is here; nothing is imported before it is used.
"""

from __future__ import annotations

import importlib
from typing import TYPE_CHECKING, Any

__version__ = "0.1.0"

_WHERE = {
    "AGENTS": "phase_ppl.world.names",
    "ALPHAS": "phase_ppl.world.hypothesis",
    "Answer": "phase_ppl.evaluation.answer",
    "Comparison": "phase_ppl.analysis.comparison",
    "ComparisonInterrupted": "phase_ppl.inference.compare",
    "Estimate": "phase_ppl.analysis.estimate",
    "Evaluation": "phase_ppl.evaluation.evaluation",
    "EvaluationInterrupted": "phase_ppl.evaluation.evaluate",
    "Event": "phase_ppl.world.event",
    "GOALS": "phase_ppl.world.goals",
    "GeneratedEvents": "phase_ppl.dataset.generation.store",
    "GenerationInterrupted": "phase_ppl.dataset.generation.generate",
    "Hypothesis": "phase_ppl.world.hypothesis",
    "Interrupted": "phase_ppl.inference.infer",
    "JointSimulator": "phase_ppl.simulator.joint",
    "Judgments": "phase_ppl.evaluation.votes",
    "Model": "phase_ppl.models.model",
    "ModelComparison": "phase_ppl.evaluation.comparison.comparison",
    "Observation": "phase_ppl.world.observation",
    "PhasePPLError": "phase_ppl.world.errors",
    "PlannerConfig": "phase_ppl.agents.config",
    "Posterior": "phase_ppl.analysis.posterior",
    "Prediction": "phase_ppl.evaluation.prediction",
    "QueryError": "phase_ppl.world.errors",
    "RadialLikelihood": "phase_ppl.models.likelihood",
    "Scene": "phase_ppl.world.scene",
    "SimpleSettings": "phase_ppl.inference.infer",
    "SimulationError": "phase_ppl.world.errors",
    "StepwiseInterrupted": "phase_ppl.inference.stepwise.enumerate",
    "StepwiseLikelihood": "phase_ppl.models.stepwise",
    "StepwisePosterior": "phase_ppl.analysis.stepwise_posterior",
    "Study": "phase_ppl.evaluation.judgments",
    "Tracking": "phase_ppl.closed_loop.hidden_state",
    "Truth": "phase_ppl.world.event",
    "Watch": "phase_ppl.inference.stepwise.watch",
    "available_families": "phase_ppl.dataset.generation.registry",
    "available_kernels": "phase_ppl.inference.registry",
    "available_models": "phase_ppl.evaluation.registry",
    "bundled_events": "phase_ppl.dataset.bundled",
    "carried_evaluation": "phase_ppl.evaluation.carried",
    "compare": "phase_ppl.inference.compare",
    "compare_models": "phase_ppl.evaluation.comparison.comparison",
    "evaluate": "phase_ppl.evaluation.evaluate",
    "evaluate_predictions": "phase_ppl.evaluation.metrics",
    "event_dataset": "phase_ppl.dataset.xarrays",
    "event_from_dataset": "phase_ppl.dataset.xarrays",
    "export_events": "phase_ppl.dataset.export",
    "frames": "phase_ppl.inference.infer",
    "generate": "phase_ppl.dataset.generation.generate",
    "human_accuracy": "phase_ppl.evaluation.people",
    "infer": "phase_ppl.inference.infer",
    "kernel_info": "phase_ppl.inference.registry",
    "load_event": "phase_ppl.dataset.load",
    "load_events": "phase_ppl.dataset.load",
    "load_judgments": "phase_ppl.evaluation.judgments",
    "load_posterior": "phase_ppl.analysis.load",
    "model_info": "phase_ppl.evaluation.registry",
    "paired_difference": "phase_ppl.evaluation.metrics",
    "reference_models": "phase_ppl.evaluation.metrics",
    "reference_predictions": "phase_ppl.evaluation.references",
    "register_family": "phase_ppl.dataset.generation.registry",
    "register_kernel": "phase_ppl.inference.registry",
    "register_model": "phase_ppl.evaluation.registry",
    "report": "phase_ppl.evaluation.report",
    "resume": "phase_ppl.inference.infer",
    "save_event": "phase_ppl.dataset.load",
    "save_events": "phase_ppl.dataset.load",
    "seconds": "phase_ppl.inference.infer",
    "simulate": "phase_ppl.simulator.simulate",
    "simulations": "phase_ppl.inference.infer",
    "statistics": "phase_ppl.dataset.statistics",
    "train_socialgnn": "phase_ppl.evaluation.training",
    "watch": "phase_ppl.inference.stepwise.watch",
    "watch_film": "phase_ppl.analysis.watch_film",
    "with_judgments": "phase_ppl.evaluation.judgments",
}

_MODULES = {
    "figures": "phase_ppl.evaluation.figures",
    "plot": "phase_ppl.analysis.plots",
    "priors": "phase_ppl.models.priors",
    "render": "phase_ppl.render",
    "sites": "phase_ppl.models.sites",
}

__all__ = ["__version__", *sorted(_WHERE), *sorted(_MODULES)]

if TYPE_CHECKING:
    from phase_ppl import render as render
    from phase_ppl.agents.config import PlannerConfig as PlannerConfig
    from phase_ppl.analysis import plots as plot
    from phase_ppl.analysis.comparison import Comparison as Comparison
    from phase_ppl.analysis.estimate import Estimate as Estimate
    from phase_ppl.analysis.load import load_posterior as load_posterior
    from phase_ppl.analysis.posterior import Posterior as Posterior
    from phase_ppl.analysis.stepwise_posterior import StepwisePosterior as StepwisePosterior
    from phase_ppl.analysis.watch_film import watch_film as watch_film
    from phase_ppl.closed_loop.hidden_state import Tracking as Tracking
    from phase_ppl.dataset.bundled import bundled_events as bundled_events
    from phase_ppl.dataset.export import export_events as export_events
    from phase_ppl.dataset.generation.generate import (
        GenerationInterrupted as GenerationInterrupted,
    )
    from phase_ppl.dataset.generation.generate import generate as generate
    from phase_ppl.dataset.generation.registry import available_families as available_families
    from phase_ppl.dataset.generation.registry import register_family as register_family
    from phase_ppl.dataset.generation.store import GeneratedEvents as GeneratedEvents
    from phase_ppl.dataset.load import load_event as load_event
    from phase_ppl.dataset.load import load_events as load_events
    from phase_ppl.dataset.load import save_event as save_event
    from phase_ppl.dataset.load import save_events as save_events
    from phase_ppl.dataset.statistics import statistics as statistics
    from phase_ppl.dataset.xarrays import event_dataset as event_dataset
    from phase_ppl.dataset.xarrays import event_from_dataset as event_from_dataset
    from phase_ppl.evaluation import figures as figures
    from phase_ppl.evaluation.answer import Answer as Answer
    from phase_ppl.evaluation.carried import carried_evaluation as carried_evaluation
    from phase_ppl.evaluation.comparison.comparison import ModelComparison as ModelComparison
    from phase_ppl.evaluation.comparison.comparison import compare_models as compare_models
    from phase_ppl.evaluation.evaluate import EvaluationInterrupted as EvaluationInterrupted
    from phase_ppl.evaluation.evaluate import evaluate as evaluate
    from phase_ppl.evaluation.evaluation import Evaluation as Evaluation
    from phase_ppl.evaluation.judgments import Study as Study
    from phase_ppl.evaluation.judgments import load_judgments as load_judgments
    from phase_ppl.evaluation.judgments import with_judgments as with_judgments
    from phase_ppl.evaluation.metrics import evaluate_predictions as evaluate_predictions
    from phase_ppl.evaluation.metrics import paired_difference as paired_difference
    from phase_ppl.evaluation.metrics import reference_models as reference_models
    from phase_ppl.evaluation.people import human_accuracy as human_accuracy
    from phase_ppl.evaluation.prediction import Prediction as Prediction
    from phase_ppl.evaluation.references import reference_predictions as reference_predictions
    from phase_ppl.evaluation.registry import available_models as available_models
    from phase_ppl.evaluation.registry import model_info as model_info
    from phase_ppl.evaluation.registry import register_model as register_model
    from phase_ppl.evaluation.report import report as report
    from phase_ppl.evaluation.training import train_socialgnn as train_socialgnn
    from phase_ppl.evaluation.votes import Judgments as Judgments
    from phase_ppl.inference.compare import ComparisonInterrupted as ComparisonInterrupted
    from phase_ppl.inference.compare import compare as compare
    from phase_ppl.inference.infer import Interrupted as Interrupted
    from phase_ppl.inference.infer import SimpleSettings as SimpleSettings
    from phase_ppl.inference.infer import frames as frames
    from phase_ppl.inference.infer import infer as infer
    from phase_ppl.inference.infer import resume as resume
    from phase_ppl.inference.infer import seconds as seconds
    from phase_ppl.inference.infer import simulations as simulations
    from phase_ppl.inference.registry import available_kernels as available_kernels
    from phase_ppl.inference.registry import kernel_info as kernel_info
    from phase_ppl.inference.registry import register_kernel as register_kernel
    from phase_ppl.inference.stepwise.enumerate import StepwiseInterrupted as StepwiseInterrupted
    from phase_ppl.inference.stepwise.watch import Watch as Watch
    from phase_ppl.inference.stepwise.watch import watch as watch
    from phase_ppl.models import priors as priors
    from phase_ppl.models import sites as sites
    from phase_ppl.models.likelihood import RadialLikelihood as RadialLikelihood
    from phase_ppl.models.model import Model as Model
    from phase_ppl.models.stepwise import StepwiseLikelihood as StepwiseLikelihood
    from phase_ppl.simulator.joint import JointSimulator as JointSimulator
    from phase_ppl.simulator.simulate import simulate as simulate
    from phase_ppl.world.errors import PhasePPLError as PhasePPLError
    from phase_ppl.world.errors import QueryError as QueryError
    from phase_ppl.world.errors import SimulationError as SimulationError
    from phase_ppl.world.event import Event as Event
    from phase_ppl.world.event import Truth as Truth
    from phase_ppl.world.goals import GOALS as GOALS
    from phase_ppl.world.hypothesis import ALPHAS as ALPHAS
    from phase_ppl.world.hypothesis import Hypothesis as Hypothesis
    from phase_ppl.world.names import AGENTS as AGENTS
    from phase_ppl.world.observation import Observation as Observation
    from phase_ppl.world.scene import Scene as Scene


def __getattr__(name: str) -> Any:
    if name in _MODULES:
        value: Any = importlib.import_module(_MODULES[name])
    elif name in _WHERE:
        value = getattr(importlib.import_module(_WHERE[name]), name)
    else:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    globals()[name] = value
    return value


def __dir__() -> list[str]:
    return sorted(__all__)
