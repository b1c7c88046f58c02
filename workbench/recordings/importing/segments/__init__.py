"""Refusal of tables whose reading changes at a row: unit, sign, order, convention, or a shift of rows."""
