"""Nested cross-validation, the only rule by which a term is accepted.

`folds` divides the samples; `held_out` predicts those left out; `judging` decides which division can test a term;
`controls` permutes or shifts a cause; `proof` repeats the search in the folds and combines all tests.
"""
