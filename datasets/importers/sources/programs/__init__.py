"""Robot programs: positions of the controllers' files, their tool and frame, and programs with other positions."""
