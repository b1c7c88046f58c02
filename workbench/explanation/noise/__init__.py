"""Noise of a recording: stated, estimated from replicates, or growing with the distance."""
