"""The statement, its wording, and the numbers behind its figures."""
