"""What trained networks say of an event. Importing this module needs PyTorch."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import torch
from numpy.typing import NDArray

from phase_ppl.models.neural import threads
from phase_ppl.models.socialgnn.graphs import Graphs, Variant, batch, frame_graphs
from phase_ppl.models.socialgnn.network import SocialGNN
from phase_ppl.models.socialgnn.store import Arrays, Trained
from phase_ppl.world.observation import Observation
from phase_ppl.world.scene import Scene


class Ensemble:
    """Trained networks that answer together: the mean of their probabilities.

    Args:
        trained: the networks.
        n_threads: of PyTorch.
    """

    def __init__(self, trained: Trained, n_threads: int = 1) -> None:
        self._variant: Variant = trained.variant
        self._threads = n_threads
        self._networks = [_network(arrays, trained.variant) for arrays in trained.members]

    def __call__(self, scene: Scene, observation: Observation) -> dict[str, NDArray[np.float64]]:
        """Return the probabilities of the answers of each head, by its name."""
        return self.of(frame_graphs(scene, observation, self._variant))

    def of(self, graphs: Graphs) -> dict[str, NDArray[np.float64]]:
        """Return the same for the graphs of an event's frames."""
        given = batch([graphs])
        with threads(self._threads), torch.no_grad():
            said = [network(given) for network in self._networks]
            found = {"relation": _mean([one.relation[0] for one in said])}
            if said[0].goals is not None:
                for agent, name in enumerate(("goal_red", "goal_green")):
                    found[name] = _mean([one.goals[0, agent] for one in said])
        return found


def _mean(scores: Sequence[torch.Tensor]) -> NDArray[np.float64]:
    shares = torch.stack([one.double().softmax(dim=-1) for one in scores]).mean(dim=0)
    return np.asarray(shares.numpy(), np.float64)


def _network(arrays: Arrays, variant: Variant) -> SocialGNN:
    with torch.random.fork_rng(devices=[]):
        network = SocialGNN(variant)
    network.load_state_dict(
        {name: torch.from_numpy(array.astype(np.float32)) for name, array in arrays.items()}
    )
    return network.eval()
