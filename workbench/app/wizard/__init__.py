"""The import wizard without its page: dropped files, the mapping as a form, and the test of a mapping on the robot."""
