"""The world's definitions, tested as facts."""
