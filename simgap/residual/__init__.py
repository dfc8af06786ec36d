"""A diagnosed simulator with what it misses, learnt: durations of rows, and a residual as a Bayesian neural network."""
