"""The numerical core: Levenberg-Marquardt on dense or block-sparse normal equations, linear algebra
for rank-deficient matrices, identifiability, tests of an adjustment, and optimal design."""
