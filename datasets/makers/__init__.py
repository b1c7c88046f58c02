"""Generators of the bundled recordings, of recordings after papers, and of blind cases, each from its seed."""
