"""Scores on held-out sessions, and the verdict."""
