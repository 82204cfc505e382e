"""Models of social perception over many events: predictions, the paper's metrics, figures."""
