"""Files of a diagnosis: the corrected model as plan, solution and scene, and the next experiment."""
