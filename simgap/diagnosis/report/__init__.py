"""The statement, its words, and the numbers behind its figures."""
