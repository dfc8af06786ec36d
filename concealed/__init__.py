"""Recordings with concealed effects, and their keys. Shares no code with what diagnoses; plain numpy, sub-stepped."""
