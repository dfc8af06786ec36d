"""Policies: learnt in learnt dynamics by soft actor-critic, and run on a robot along references."""
