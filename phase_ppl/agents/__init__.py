"""Agents: vision, beliefs, predicates, subgoal planner, action planner."""
