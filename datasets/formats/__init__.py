"""One file for each format on disk: recording/1, and the native layout of every known real set."""
