"""Every public name and where it is: what type checkers read, and the package's own table."""

import phase_study as _study
from phase_films.reading import VideoReading as VideoReading
from phase_films.reading import read_video as read_video
from phase_people import observers as observers
from phase_people.design import design as design
from phase_people.fit import FittedObserver as FittedObserver
from phase_people.fit import PeopleFit as PeopleFit
from phase_people.fit_people import evidence_from as evidence_from
from phase_people.fit_people import fit_people as fit_people
from phase_people.information import Design as Design
from phase_people.observers import Observer as Observer
from phase_people.observers import Perception as Perception
from phase_ppl import render as render
from phase_ppl.agents.config import PlannerConfig as PlannerConfig
from phase_ppl.analysis import figures as _plots
from phase_ppl.analysis.closed_loop_posterior import ClosedLoopPosterior as ClosedLoopPosterior
from phase_ppl.analysis.comparison import Comparison as Comparison
from phase_ppl.analysis.estimate import Estimate as Estimate
from phase_ppl.analysis.figures.over_time import watch_film as watch_film
from phase_ppl.analysis.posterior import Posterior as Posterior
from phase_ppl.analysis.posterior import load_posterior as load_posterior
from phase_ppl.analysis.with_arviz import arviz_groups as arviz_groups
from phase_ppl.analysis.with_arviz import pareto_smoothed as pareto_smoothed
from phase_ppl.closed_loop.hidden_state import Tracking as Tracking
from phase_ppl.data import cues as cues
from phase_ppl.data.documents import read_json as read_json
from phase_ppl.data.generated import GeneratedEvents as GeneratedEvents
from phase_ppl.data.generation.families import available_families as available_families
from phase_ppl.data.generation.families import draw_situation as draw_situation
from phase_ppl.data.generation.families import register_family as register_family
from phase_ppl.data.generation.generate import (
    GenerationInterrupted as GenerationInterrupted,
)
from phase_ppl.data.generation.generate import generate as generate
from phase_ppl.data.load import bundled_events as bundled_events
from phase_ppl.data.load import event_dataset as event_dataset
from phase_ppl.data.load import load_event as load_event
from phase_ppl.data.load import load_events as load_events
from phase_ppl.data.load import save_event as save_event
from phase_ppl.data.load import save_events as save_events
from phase_ppl.data.motion import items_held as items_held
from phase_ppl.data.motion import observed_turning as observed_turning
from phase_ppl.data.statistics import statistics as statistics
from phase_ppl.evaluation import figures as figures
from phase_ppl.evaluation.calibration import Calibration as Calibration
from phase_ppl.evaluation.calibration import calibrate as calibrate
from phase_ppl.evaluation.comparison import ModelComparison as ModelComparison
from phase_ppl.evaluation.evaluate import EvaluationInterrupted as EvaluationInterrupted
from phase_ppl.evaluation.evaluate import evaluate as evaluate
from phase_ppl.evaluation.evaluation import Evaluation as Evaluation
from phase_ppl.evaluation.evaluation import compare_models as compare_models
from phase_ppl.evaluation.folder import all_events as all_events
from phase_ppl.evaluation.judgments import Study as Study
from phase_ppl.evaluation.judgments import load_judgments as load_judgments
from phase_ppl.evaluation.judgments import with_judgments as with_judgments
from phase_ppl.evaluation.metrics import evaluate_predictions as evaluate_predictions
from phase_ppl.evaluation.metrics import human_accuracy as human_accuracy
from phase_ppl.evaluation.models.socialgnn import train_socialgnn as train_socialgnn
from phase_ppl.evaluation.prediction import Prediction as Prediction
from phase_ppl.evaluation.prediction import pairs_of as pairs_of
from phase_ppl.evaluation.prediction import questions_of as questions_of
from phase_ppl.evaluation.prediction import reference_predictions as reference_predictions
from phase_ppl.evaluation.ratings import Judgments as Judgments
from phase_ppl.evaluation.registry import Answer as Answer
from phase_ppl.evaluation.registry import Onlooker as Onlooker
from phase_ppl.evaluation.registry import available_models as available_models
from phase_ppl.evaluation.registry import model_info as model_info
from phase_ppl.evaluation.registry import register_model as register_model
from phase_ppl.evaluation.report import report as report
from phase_ppl.evaluation.reproduce import Reproduction as Reproduction
from phase_ppl.evaluation.reproduce import reproduce as reproduce
from phase_ppl.inference import kernels as kernels
from phase_ppl.inference import priors as priors
from phase_ppl.inference.closed_loop import ClosedLoopInterrupted as ClosedLoopInterrupted
from phase_ppl.inference.closed_loop import Watch as Watch
from phase_ppl.inference.closed_loop import watch as watch
from phase_ppl.inference.compare import ComparisonInterrupted as ComparisonInterrupted
from phase_ppl.inference.compare import compare as compare
from phase_ppl.inference.infer import infer as infer
from phase_ppl.inference.infer import resume as resume
from phase_ppl.inference.native import program as program
from phase_ppl.inference.registry import available_kernels as available_kernels
from phase_ppl.inference.registry import kernel_info as kernel_info
from phase_ppl.inference.registry import register_kernel as register_kernel
from phase_ppl.inference.sampler import Interrupted as Interrupted
from phase_ppl.inference.settings import SimpleSettings as SimpleSettings
from phase_ppl.inference.settings import frames as frames
from phase_ppl.inference.settings import preset as preset
from phase_ppl.inference.settings import seconds as seconds
from phase_ppl.inference.settings import simulations as simulations
from phase_ppl.models import sites as sites
from phase_ppl.models import world_priors as _world_priors
from phase_ppl.models.closed_loop import ClosedLoopLikelihood as ClosedLoopLikelihood
from phase_ppl.models.density import tracing as tracing
from phase_ppl.models.likelihood import RadialLikelihood as RadialLikelihood
from phase_ppl.models.model import Model as Model
from phase_ppl.models.priors import register_prior as register_prior
from phase_ppl.models.program import EventProgram as EventProgram
from phase_ppl.physics.actions import Action as Action
from phase_ppl.render.explain import explain as explain
from phase_ppl.simulator.joint import JointSimulator as JointSimulator
from phase_ppl.simulator.joint import simulate as simulate
from phase_ppl.simulator.stage import Stage as Stage
from phase_ppl.world import errors as errors
from phase_ppl.world import files as files
from phase_ppl.world import goals as goals
from phase_ppl.world import worlds as worlds
from phase_ppl.world.errors import PhasePPLError as PhasePPLError
from phase_ppl.world.errors import QueryError as QueryError
from phase_ppl.world.errors import SimulationError as SimulationError
from phase_ppl.world.event import SHOWN_SECONDS_PER_FRAME as SHOWN_SECONDS_PER_FRAME
from phase_ppl.world.event import Event as Event
from phase_ppl.world.event import Observation as Observation
from phase_ppl.world.event import Truth as Truth
from phase_ppl.world.goals import GOALS as GOALS
from phase_ppl.world.hypothesis import ALPHAS as ALPHAS
from phase_ppl.world.hypothesis import Hypothesis as Hypothesis
from phase_ppl.world.names import AGENTS as AGENTS
from phase_ppl.world.predicates import Predicate as Predicate
from phase_ppl.world.progress import counted as counted
from phase_ppl.world.progress import progress_is_shown as progress_is_shown
from phase_ppl.world.scene import Scene as Scene
from phase_ppl.world.scene import World as World

__version__: str
plot = _plots
roles = _world_priors
study = _study

def unsupported() -> str | None: ...
