"""The laser's line in pictures: sub-pixel centres, whole stacks at a time."""
