"""Camera, light planes, mirror, stripe, scanner, ball and board: from images to points."""
