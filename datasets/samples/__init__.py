"""The table samples.csv: its columns, what must hold for every row, repeated rows, and long tables in chunks."""
