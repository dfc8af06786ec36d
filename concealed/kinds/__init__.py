"""Machines of five kinds, whose users have a simulator each, with something that it lacks."""
