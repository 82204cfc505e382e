"""What the observation suggests: bottom-up proposals of goals, alpha and strengths."""
