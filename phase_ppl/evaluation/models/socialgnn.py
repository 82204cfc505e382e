"""SocialGNN, a network that answers from a glance at the motion (paper, Appendix "SocialGNN")."""

from __future__ import annotations

import dataclasses
import functools
from pathlib import Path
from typing import TYPE_CHECKING, Any

from phase_ppl.evaluation.prediction import Prediction
from phase_ppl.evaluation.registry import register_model
from phase_ppl.world.errors import InvalidSettingError, whole_number
from phase_ppl.world.event import Observation
from phase_ppl.world.scene import Scene

if TYPE_CHECKING:
    from phase_ppl.models.socialgnn.network import Ensemble
    from phase_ppl.models.socialgnn.store import Trained


@dataclasses.dataclass(frozen=True, eq=False)
class SocialGNNModel:
    """Trained networks, ready to be asked."""

    trained: Trained  # the networks whose probabilities are averaged
    n_threads: int = 1  # of PyTorch

    def __call__(self, scene: Scene, observation: Observation, seed: int) -> Prediction:
        """Return what the networks say; nothing in it is random."""
        return Prediction("", probabilities=self._ensemble(scene, observation))

    @functools.cached_property
    def _ensemble(self) -> Ensemble:
        from phase_ppl.models.socialgnn.network import Ensemble

        return Ensemble(self.trained, self.n_threads)

    def warm_up(self) -> None:
        """Import PyTorch and make the networks, so that the first event does not pay for it."""
        _ = self._ensemble

    def settings(self) -> dict[str, Any]:
        """Return what determines the answers."""
        return {
            "variant": self.trained.variant,
            "networks": len(self.trained.members),
            "weights": self.trained.digest(),
            "threads": self.n_threads,
        }


# a prediction takes less than a process does to start
@register_model("socialgnn", parallel=False, needs=("torch",), extra="neural")
def socialgnn(
    *,
    variant: str | None = None,
    weights: str | Path | None = None,
    member: int | None = None,
    threads: int = 1,
) -> SocialGNNModel:
    """SocialGNN: a graph neural network that says goals and relation from the motion alone.

    The package's own networks were trained on events that it generated, not on PHASE. They saw the
    splits train and validation of the set named in ``report.json`` in their files; only its split
    test is new to them. ``phase-ppl train socialgnn`` trains others.

    Args:
        variant: "extended", the paper's and the default; "original", the authors', which says the
            relation only; not with ``weights``, which are of one.
        weights: an npz file, or the folder that training wrote, instead of those of the package.
        member: the answers of this network alone, from 0, instead of the mean over all seeds.
        threads: of PyTorch.
    """
    from phase_ppl.models.socialgnn.store import load, shipped

    if weights is None:
        trained = shipped(variant or "extended")
    elif variant is None:
        trained = load(weights)
    else:
        raise InvalidSettingError(f"give either weights or variant={variant!r}, not both")
    if member is not None:
        n = len(trained.members)
        if whole_number("member", member, 0) >= n:
            raise InvalidSettingError(
                f"member={member}, expected {'0' if n == 1 else f'0 to {n - 1}'}: there are {n}"
            )
        trained = trained._replace(members=trained.members[member : member + 1])
    return SocialGNNModel(trained, whole_number("threads", threads))
