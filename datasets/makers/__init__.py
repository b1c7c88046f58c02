"""Scripts that make the bundled and the paper-like recordings, each from its seed."""
