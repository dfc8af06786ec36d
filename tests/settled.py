"""Settles the environment of tests: a plugin that pytest loads before all others, some of which import numpy.

What numpy's matrix products read when it is imported, later settings do not change: with a thread on each core in each
of several workers, they take a hundred times as long.
"""

from simgap.cli import environment

environment.settle(environment.numerics())
