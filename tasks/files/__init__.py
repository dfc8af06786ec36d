"""Data files: recordings in, every stage's results out and back in.

A file is written whole or not at all, and equal content makes equal bytes, so that caches and digests hold.
"""
