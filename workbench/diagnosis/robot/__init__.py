"""The bench of a robot: solves baseline and effects, and lists what may be missing.

`library` lists the effects of the catalogue, `places` where a smooth function may act; `mass_responses` makes
elastic laws whose masses are estimated; `linearised` makes the arrays of a fit.
"""
