"""What the commands share: reading samples, running a job, tables, and the answer on the terminal."""
