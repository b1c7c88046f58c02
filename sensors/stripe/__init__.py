"""The laser's line in images: sub-pixel centres, whole stacks at a time."""
