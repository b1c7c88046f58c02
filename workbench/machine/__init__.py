"""The machine: installed packages and system libraries, worker processes, progress, standard streams."""
