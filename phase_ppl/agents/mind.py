"""What both agents of a simulation know alike: the layout, and the physics they imagine."""

from __future__ import annotations

from typing import NamedTuple

from phase_ppl.agents.config import PlannerConfig
from phase_ppl.agents.ground import Ground, make_ground
from phase_ppl.agents.operators import Abilities
from phase_ppl.physics import compiled
from phase_ppl.world.scene import Scene


class Mind(NamedTuple):
    """What both agents of a simulation share: the layout and the physics they imagine."""

    scene: Scene
    ground: Ground
    params: compiled.Params
    abilities: Abilities

    @classmethod
    def of(cls, scene: Scene, strengths: tuple[float, float], config: PlannerConfig) -> Mind:
        return cls(
            scene,
            make_ground(scene),
            compiled.make_params(
                scene, strengths, inner_steps=config.inner_steps, swivel=config.swivel
            ),
            Abilities.of(scene, strengths),
        )
