"""Ratios against named baselines; each module is run by itself, `python -m benchmarks.<name>`.

Importing `flows` settles the environment as the pipeline has it, before jax is imported.
"""

import flows  # noqa: F401
