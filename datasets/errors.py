"""The one error of everything that a user can get wrong in a file, and how its sentence is built."""

from workbench.core.errors import InputError, complaint

__all__ = ["InputError", "complaint"]
