"""Import and inspection of recordings before any fit.

`importing` makes recordings from files of other programs, `templates` writes commented examples to fill in, and
`inspection` judges a recording: coverage, repeats, noise, and what is missing for which command.
"""
