"""From the headers of a table to quantities: words, sets of columns that belong together, and their units."""
