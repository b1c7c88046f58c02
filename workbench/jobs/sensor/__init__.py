"""Jobs of the commands for a vision sensor."""
