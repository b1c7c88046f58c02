"""The search for missing terms: a stepwise search that maximises one objective, the log posterior of a set of terms.

`objective` weighs a set from inner products alone; `prior` says what is known of terms before the data speak, of
elastic ones in particular; `compatible` which terms exclude one another; `stepwise` adds, drops and exchanges terms
from several starts; `most_probable_set` repeats that about each new solution until the set stays; `posterior`
exchanges names for likelier ones and gives those of elastic terms their probabilities; `state` holds what is accepted
and the problem solved with it.
"""
