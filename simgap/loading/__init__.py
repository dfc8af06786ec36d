"""Simulators of a user's own: found by name, and checked before anything is computed with them.

A mistake in a simulator shows far from its cause, as a fit that does not converge. So every member is checked here, and
a message says what must hold, what came and what to do. The check runs the user's code for the first time, in a process
of its own (`trial`): that code may end its process or never end.
"""
