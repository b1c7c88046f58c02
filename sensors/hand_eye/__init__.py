"""Hand-eye transform of the sensor: from images of a board, or from profiles or centres of balls."""
