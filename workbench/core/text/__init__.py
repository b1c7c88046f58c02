"""Text that comes from or goes to files: CSV, file names and key names with a suggestion."""
