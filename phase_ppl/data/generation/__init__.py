"""Generation of data like PHASE: draw a situation, simulate it, keep it if it is as intended."""
