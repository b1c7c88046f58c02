"""Scoreboard of the blind benchmark as HTML and Markdown, with its figures."""
