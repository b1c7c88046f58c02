"""Checks of hand-eye data: fits from board poses alone, mistakes as alternative explanations, and a review."""
