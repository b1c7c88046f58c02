"""Data of the app as plain arrays: runs and recordings, chosen rows, images with what was detected in them."""
