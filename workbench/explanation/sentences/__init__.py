"""Findings in sentences: their words, one paragraph on each, and warnings about implausible values."""
