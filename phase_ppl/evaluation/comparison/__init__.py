"""Models of social perception side by side, with people, on the same events."""
