"""Tasks of the sealed suites: recordings with concealed effects, their diagnosis, and the score."""
