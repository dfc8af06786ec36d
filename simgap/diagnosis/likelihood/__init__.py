"""The likelihood of recordings under a simulator: segments, filter, noise, derivatives."""
