"""Simulators as a user would write them, and recordings of machines with physics that these leave out."""
