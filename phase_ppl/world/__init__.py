"""The world in the paper's words: goals, relations, rooms, scene, event, hypothesis."""
