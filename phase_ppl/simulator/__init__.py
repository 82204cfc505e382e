"""The simulator contract, the joint simulator, and the runner with its workers."""
