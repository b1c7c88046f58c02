"""Where the sensor sits on the flange: from pictures of a board, from profiles of one ball."""
