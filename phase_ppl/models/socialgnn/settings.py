"""How a network is trained."""

from __future__ import annotations

import dataclasses
import math
from typing import Any

from phase_ppl.models.socialgnn.graphs import Variant, checked_variant
from phase_ppl.world.checks import whole_number
from phase_ppl.world.errors import InvalidSettingError, shown


@dataclasses.dataclass(frozen=True)
class TrainingSettings:
    """How one network is trained; the paper gives the loss, the numbers are this package's.

    Attributes:
        variant: "extended" (relation and goals) or "original" (relation only).
        epochs: passes over the training events, at most.
        patience: epochs without a smaller loss on the validation events after which it ends; the
            network of the smallest one counts.
        batch: events per step.
        learning_rate: of Adam at the start; halved after a third of the patience without progress.
        decay: lambda, weight of the squared norm of all weights in the loss.
        dropout: share of units left out in each step.
        balanced: whether relations that are rare among the training events weigh more. The loss of
            a batch is their weighted mean, so that in batches of one event this changes nothing.
        looks: whether an event is reflected and recoloured anew in each epoch.
        threads: of PyTorch; the result depends on it.

    Raises:
        InvalidSettingError, UnknownNameError: a value that is not allowed.
    """

    variant: Variant = "extended"
    epochs: int = 250
    patience: int = 40
    batch: int = 16
    learning_rate: float = 3e-3
    decay: float = 3e-5
    dropout: float = 0.2
    balanced: bool = True
    looks: bool = True
    threads: int = 1

    def __post_init__(self) -> None:
        checked_variant(self.variant)
        for name in ("epochs", "patience", "batch", "threads"):
            whole_number(name, getattr(self, name))
        for name in ("balanced", "looks"):
            if not isinstance(getattr(self, name), bool):
                raise InvalidSettingError(
                    f"{name}={shown(getattr(self, name))}, expected True or False"
                )
        for name, low, high in (
            ("learning_rate", 1e-7, 1.0), ("decay", 0.0, 1.0), ("dropout", 0.0, 0.9),
        ):  # fmt: skip
            value = getattr(self, name)
            number = isinstance(value, int | float) and not isinstance(value, bool)
            if not (number and math.isfinite(value) and low <= value <= high):
                raise InvalidSettingError(
                    f"{name}={shown(value)}, expected a number from {low:g} to {high:g}"
                )

    def to_dict(self) -> dict[str, Any]:
        """Return it as plain data."""
        return dataclasses.asdict(self)
