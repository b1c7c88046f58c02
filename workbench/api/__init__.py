"""The Python API: every command as a function, recordings from arrays, and results to look at.

`functions` makes a function of each command from the command's own signature. `inputs` turns
recordings, arrays and tables into the files that a command reads; `results` holds what comes back.
`workbench` itself hands out the public names.
"""
