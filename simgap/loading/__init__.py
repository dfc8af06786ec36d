"""Loads a user's own simulator by name, and checks it before anything is computed with it.

A mistake in a simulator would show far from its cause, as a fit that does not converge. So every member is checked
here, and a message says what must hold, what came and what to do. The check runs the user's code for the first time, in
a separate process (`trial`), because that code may end its process or never end.
"""
