"""Nested cross-validation, the only rule by which a term is accepted.

`folds` parts the samples; `held_out` predicts those left out; `judging` says which split can judge a term; `controls`
permutes or shifts a cause; `proof` searches the folds and brings these together.
"""
