"""Pages of the commands that judge models and poses: `compare`, `identifiability`, `poses` and `significance`."""
