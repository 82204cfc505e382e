"""Training one network. Importing this module needs PyTorch."""

from __future__ import annotations

import copy
from collections.abc import Callable, Sequence
from typing import Any, Final, NamedTuple

import numpy as np
import torch
from numpy.typing import NDArray
from torch.nn import functional

from phase_ppl.models.neural import threads
from phase_ppl.models.socialgnn.examples import AS_IT_IS, LOOKS, Example, Examples
from phase_ppl.models.socialgnn.graphs import batch
from phase_ppl.models.socialgnn.network import Outputs, SocialGNN
from phase_ppl.models.socialgnn.store import TrainingSettings, halved
from phase_ppl.world.errors import InvalidSettingError
from phase_ppl.world.hypothesis import RELATIONS

Curves = dict[str, list[float]]

_SLOWER: Final = 0.5
_LONGEST_STEP: Final = 1.0
"""Norm to which gradients are cut: an LSTM over a hundred frames can make them jump."""

NEUTRAL_TWICE: Final = (1.0, 2.0, 1.0)  # weights of the relations in the authors' loss


class Fitted(NamedTuple):
    """A trained network."""

    arrays: dict[str, NDArray[np.float16]]  # by name, in half precision
    # per epoch "training" and "validation" loss without decay, and the share of the validation
    # events with the right answer: "relation", and "goals" where it names them
    curves: Curves
    best: int  # epoch, from 0, that the arrays are of


def fit(
    training: Examples,
    validation: Examples,
    settings: TrainingSettings,
    seed: int,
    after_epoch: Callable[[], object] = lambda: None,
) -> Fitted:
    """Return the network trained from a seed.

    That of the first weights, the order and looks of the events, and the dropout. ``after_epoch``
    is called after each epoch.
    """
    with threads(settings.threads), torch.random.fork_rng(devices=[]):
        torch.manual_seed(seed)
        return _Fit(training, validation, settings, np.random.default_rng(seed)).run(after_epoch)


class _Fit:
    """A training that goes on."""

    def __init__(
        self,
        training: Examples,
        validation: Examples,
        settings: TrainingSettings,
        rng: np.random.Generator,
    ) -> None:
        self.training, self.settings, self.rng = training, settings, rng
        self.held_out = [validation(event) for event in range(len(validation))]
        self.network = SocialGNN(settings.variant, settings.dropout)
        self.optimizer = torch.optim.Adam(self.network.parameters(), lr=settings.learning_rate)
        self.schedule = torch.optim.lr_scheduler.ReduceLROnPlateau(
            self.optimizer, factor=_SLOWER, patience=max(1, settings.patience // 3)
        )
        self.weights = (
            class_weights(training.relations) if settings.balanced else torch.tensor(NEUTRAL_TWICE)
        )

    def run(self, after_epoch: Callable[[], object]) -> Fitted:
        curves: Curves = {name: [] for name in ("training", "validation", "relation", "goals")}
        best, kept = 0, self.network.state_dict()
        for epoch in range(self.settings.epochs):
            curves["training"].append(self._epoch())
            if not np.isfinite(curves["training"][-1]):
                raise InvalidSettingError(
                    f"the loss is no number any more after {epoch + 1} epochs with "
                    f"learning_rate={self.settings.learning_rate:g}; try a smaller one"
                )
            for name, value in self._validate().items():
                curves[name].append(value)
            now, patience = curves["validation"][-1], self.settings.patience
            if patience:
                self.schedule.step(now)
            if epoch == 0 or not patience or now < curves["validation"][best]:
                best, kept = epoch, copy.deepcopy(self.network.state_dict())
            after_epoch()
            if patience and epoch - best >= patience:
                break
        arrays = halved({name: values.numpy() for name, values in kept.items()})
        return Fitted(arrays, {name: values for name, values in curves.items() if values}, best)

    def _epoch(self) -> float:
        """Take all training events once; return the mean loss."""
        n = len(self.training)
        looks = self.rng.integers(len(LOOKS), size=n) if self.settings.looks else [AS_IT_IS] * n
        order, losses = self.rng.permutation(n), []
        self.network.train()
        for start in range(0, n, self.settings.batch):
            chosen = order[start : start + self.settings.batch]
            examples = [self.training(int(event), int(looks[event])) for event in chosen]
            said = self.network(batch([example.graphs for example in examples]))
            found = loss(said, examples, self.weights)
            self.optimizer.zero_grad()
            (found + self.settings.decay * self._squared_norm()).backward()
            if self.settings.patience:
                torch.nn.utils.clip_grad_norm_(self.network.parameters(), _LONGEST_STEP)
            self.optimizer.step()
            losses.append(found.item() * len(chosen))
        return sum(losses) / n

    def _squared_norm(self) -> Any:
        return sum((values**2).sum() for values in self.network.parameters())

    def _validate(self) -> dict[str, float]:
        self.network.eval()
        with torch.no_grad():
            said = self.network(batch([example.graphs for example in self.held_out]))
            found = {"validation": loss(said, self.held_out, self.weights).item()}
        relations, goals = _truth(self.held_out)
        found["relation"] = (said.relation.argmax(dim=-1) == relations).double().mean().item()
        if said.goals is not None:
            found["goals"] = (said.goals.argmax(dim=-1) == goals).double().mean().item()
        return found


def class_weights(relations: Sequence[int]) -> Any:
    """Return (relation,) weights in inverse proportion to how often each is there.

    Those of the events themselves have mean 1; a relation that is never there has weight 1.
    """
    counts = np.bincount(relations, minlength=len(RELATIONS))
    there = counts > 0
    weights = np.where(there, len(relations) / (there.sum() * np.maximum(counts, 1)), 1.0)
    return torch.from_numpy(weights.astype(np.float32))


def loss(said: Outputs, examples: Sequence[Example], weights: Any = None) -> Any:
    """Return L_relation + L_goal, the latter the sum of the two agents' (paper, appendix)."""
    relations, goals = _truth(examples)
    found = functional.cross_entropy(said.relation, relations, weights)
    if said.goals is not None:
        for agent in range(goals.shape[1]):
            found = found + functional.cross_entropy(said.goals[:, agent], goals[:, agent])
    return found


def _truth(examples: Sequence[Example]) -> tuple[Any, Any]:
    """Return (event,) relations and (event, agent) goals."""
    relations = torch.tensor([example.relation for example in examples])
    return relations, torch.tensor([example.goals for example in examples])
