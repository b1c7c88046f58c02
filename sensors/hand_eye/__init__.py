"""Where the sensor sits on the flange: from images of a board, from profiles of one ball."""
