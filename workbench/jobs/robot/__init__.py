"""What the commands for an arm run."""
