"""The command `simgap`."""

import argparse
import sys
from pathlib import Path

from flows.diagnose import diagnose_folder
from flows.start import guarded


def main() -> None:
    """`simgap diagnose RECORDINGS`: status 0 whatever the verdict, 1 with an explained error, 2 for wrong arguments."""
    parser = argparse.ArgumentParser("simgap", description="Find out what a simulator leaves out of its machine.")
    commands = parser.add_subparsers(metavar="COMMAND", required=True)
    diagnose = commands.add_parser("diagnose", help="say what a simulator leaves out of recordings")
    diagnose.add_argument("recordings", type=Path, metavar="RECORDINGS", help="folder of sessions, CSV or Parquet")
    diagnose.add_argument("--simulator", default="spot", help="spot, or one's own as package.module:name")
    diagnose.add_argument(
        "--heldout", type=Path, metavar="RECORDINGS", help="folder of sessions to judge by; else some are held out"
    )
    diagnose.add_argument(
        "--baseline", type=Path, metavar="RECORDINGS", help="folder of sessions from before the machine changed"
    )
    diagnose.add_argument(
        "--out", type=Path, default=Path("diagnosis"), metavar="DIR", help="folder for the results (default: diagnosis)"
    )
    given = parser.parse_args()
    # As `python -m` would: a simulator of one's own lies where the command is started.
    sys.path.insert(0, str(Path.cwd()))
    guarded(lambda: diagnose_folder(given.recordings, given.simulator, given.baseline, given.heldout, given.out))


if __name__ == "__main__":
    main()
