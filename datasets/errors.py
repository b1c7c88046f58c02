"""The error for all mistakes in the user's files, and the construction of its message."""

from workbench.core.errors import InputError, complaint

__all__ = ["InputError", "complaint"]
