"""What the noise of a recording is: stated, found from replicates, or growing with the distance."""
