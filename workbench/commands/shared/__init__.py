"""Shared parts of the commands: sample lists, running a job, tables, and the answer on the terminal."""
