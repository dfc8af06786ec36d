"""Experiment tracking with MLflow: one parent run per grid, one child run per cell, one run per diagnosis.

The store survives kills and fan-out.

Every call names its store and its run: no active run, which is per thread, and no global tracking URI, which MLflow
would write into the environment. A `Store` and a `Run` are names only; they travel to other threads and processes.
"""
