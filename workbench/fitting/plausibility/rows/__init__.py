"""Single rows and parts of a recording: blunders, late measurements, and a shift midway through it."""
