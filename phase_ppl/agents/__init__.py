"""Agents: they see, believe, choose a subgoal, and plan an action.

Modules in the order of a step, each built on those before it:

* ``config``: the settings. ``world_model``: what all agents know of a scene.
* ``vision``: what an agent observes. ``beliefs``: world states that agree with it, as particles.
* ``symbols``: a world state in symbols, operators, and A* over them. ``subgoals``: the subgoal of
  each particle, from an agent's goal and its stance to the others.
* ``standpoints``: which goals of all agents pose the same problem to one of them.
* ``pomcp``: the search for an action towards a subgoal.
* ``agent``: ``Agent`` plans for one goal. ``Policies`` plans for all goals at once, as the closed
  loop does.
"""
