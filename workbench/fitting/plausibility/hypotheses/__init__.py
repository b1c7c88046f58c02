"""The mistakes in a recording that the plausibility check can name: each module proposes corrections
of one kind (rows, joints, points, artefact, robot)."""
