"""Light planes and the mirror that makes them; stripes on boards as measurements of both."""
