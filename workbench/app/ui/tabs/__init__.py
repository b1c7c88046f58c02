"""The tabs of the page, one file each, with `build` (once) and `refresh` (what is drawn)."""
