"""Tables of several files as one: joined by names, by row number or by time, or one below the other."""
