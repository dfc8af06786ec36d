"""The command `simgap`, and how every command behaves: progress, locks, Ctrl-C, errors.

Modules here import nothing heavy before they have looked at what they are given.
"""
