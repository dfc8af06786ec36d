"""The training ground: machines drawn at random, whose missing physics is known, to see what a diagnosis is worth.

Their laws are not those of the vocabulary: rounded, mixed, with memories of their own, or of families that it lacks.
Code here and code that conceals the sealed suites share nothing.
"""
