"""Every test runs with the project's environment, and with a Prefect home of its own."""

import os
import tempfile

os.environ["PREFECT_LOGGING_TO_API_WHEN_MISSING_FLOW"] = "ignore"  # tasks are called without a flow here
os.environ["PREFECT_HOME"] = tempfile.mkdtemp(prefix="simgap-prefect-")

import flows  # noqa: F401  # settles the environment before any library reads it
