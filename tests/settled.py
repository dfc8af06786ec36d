"""Settles the environment of tests: a plugin that pytest loads before all others, some of which import numpy.

How many threads numpy's matrix products have is read when it is imported, and no later setting changes it. Next to
other work on the machine, these threads wait for each other, and products take a hundred times as long.
"""

from simgap.cli import environment

environment.settle(environment.numerics())
