"""One file a command: what it takes, what it prints. Nothing heavy is imported at the top."""
