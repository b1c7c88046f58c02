"""Jobs of the commands for an arm."""
