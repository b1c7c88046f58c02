"""The bench of a robot: solves baseline and effects, and lists the candidates.

`library` lists the effects of the catalogue, `places` the places where a smooth function may act, `mass_responses`
elastic laws with estimated masses; `linearised` computes the arrays of a fit.
"""
