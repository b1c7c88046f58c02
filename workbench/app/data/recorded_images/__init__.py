"""Images of a recording with what was detected in them, the image of a sample, and the reprojection error of each."""
