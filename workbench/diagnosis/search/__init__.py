"""The search for missing terms: a stepwise search that maximises one objective, the log posterior of a set of terms.

`select` runs the search; `state` contains the accepted terms and the problem solved with them. `objective` computes the
log posterior of a set from inner products; `prior` defines the prior of terms, of elastic ones in particular;
`compatible` which terms exclude one another. `stepwise` adds, drops and exchanges terms from several starts;
`most_probable_set` repeats this at each new solution until the set no longer changes. `posterior` computes the
probabilities of effects and exchanges terms for more probable ones.
"""
