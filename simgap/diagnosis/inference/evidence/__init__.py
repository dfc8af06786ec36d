"""Which hypotheses deserve a fit: score tests against the null distribution of their maximum."""
