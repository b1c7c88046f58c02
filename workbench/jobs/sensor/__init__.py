"""What the commands for a vision sensor run."""
