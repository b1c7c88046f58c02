"""Camera, light planes, mirror, stripe, scanner, ball and board: from pictures to points."""
