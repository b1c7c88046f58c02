"""Tables of text and spreadsheets: cells, separators, headers, other shapes of a table, summary rows."""
