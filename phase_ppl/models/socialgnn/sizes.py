"""Sizes of the network, and of the arrays that it is stored as."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Final

from phase_ppl.models.socialgnn.graphs import FEATURES, Variant, n_context, n_nodes
from phase_ppl.world.goals import N_GOALS
from phase_ppl.world.relations import RELATIONS

EDGE: Final = 32
"""Units of an updated edge."""

NODE: Final = 16
"""Units of an updated node."""

STATE: Final = 64
"""Units of the LSTM's state."""

HEADS: Final[Mapping[str, Mapping[str, int]]] = {
    "extended": {"relation": len(RELATIONS), "goal_red": N_GOALS, "goal_green": N_GOALS},
    "original": {"relation": len(RELATIONS)},
}
"""Variant -> head -> its answers."""


def shapes(variant: Variant) -> dict[str, tuple[int, ...]]:
    """Return the arrays of a trained network, as PyTorch calls them, with their shapes."""
    nodes = n_nodes(variant)
    features = len(FEATURES) + nodes
    layers = {
        "edge": (EDGE, 2 * features + 4 + n_context(variant)),
        "node": (NODE, features + EDGE),
        **{f"heads.{name}": (n, STATE) for name, n in HEADS[variant].items()},
    }
    found: dict[str, tuple[int, ...]] = {}
    for name, shape in layers.items():
        found |= {f"{name}.weight": shape, f"{name}.bias": shape[:1]}
    return found | {
        "lstm.weight_ih_l0": (4 * STATE, nodes * NODE),
        "lstm.weight_hh_l0": (4 * STATE, STATE),
        "lstm.bias_ih_l0": (4 * STATE,),
        "lstm.bias_hh_l0": (4 * STATE,),
    }
