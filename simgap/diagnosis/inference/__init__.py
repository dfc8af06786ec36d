"""From hypotheses to a fitted model: test, fit, select, compare, interval."""
