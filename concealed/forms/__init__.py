"""Concealed effects, a family a file: one form at least of every id of the vocabulary, and some that have no id."""
