"""Every test runs with the project's environment, and with a Prefect home of its own."""

import os
import tempfile

os.environ["PREFECT_HOME"] = tempfile.mkdtemp(prefix="simgap-prefect-")

import flows  # noqa: E402, F401  # settles the environment before any library reads it
