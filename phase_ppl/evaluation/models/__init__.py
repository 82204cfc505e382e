"""Models of social perception, a file each; each is light to import and heavy only when made."""
