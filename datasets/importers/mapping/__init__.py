"""From plain tables to the columns of a recording: header words, a mapping in TOML, joining, units and rotations.

Order: `proposal` reads the headers of all tables (`columns`), `joined_tables` makes one table, `model` is the mapping
that a user can edit, and `conversion` turns mapping and table into millimetres, degrees and unit quaternions.
"""
