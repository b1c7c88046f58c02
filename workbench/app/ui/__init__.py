"""The page, made with trame: one file for each tab, each with `build` (once) and `refresh` (what is drawn)."""
