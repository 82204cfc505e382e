"""Reading and writing events: the package's own files, the authors' videos, bundled events."""
