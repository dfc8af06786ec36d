"""Finds sessions in a folder by file names alone. Cheap to import: a wrong folder is reported at once."""

from collections.abc import Sequence
from pathlib import Path, PurePosixPath

from simgap.types import ConfigError, RecordingError

SUFFIXES = (".csv", ".parquet", ".pickle")
"""Suffixes of a session's file, in upper or lower case."""
TABLES = (".csv", ".parquet")
"""Suffixes of a table to import, in upper or lower case."""


def session_files(folder: Path, patterns: Sequence[str] = ("**/*",)) -> list[Path]:
    """The session files of a folder that match a pattern, by relative path; RecordingError where there are none."""
    if not folder.is_dir():
        raise RecordingError(
            f"{folder}: there is no such folder. Give the folder of the recording set, or put the sessions there."
        )
    found: set[Path] = set()
    for pattern in patterns:
        try:
            if ".." in PurePosixPath(pattern).parts:
                raise ValueError("it leaves the folder")
            found.update(p for p in folder.glob(pattern) if p.suffix.lower() in SUFFIXES and not p.is_dir())
        except (ValueError, NotImplementedError) as error:
            raise RecordingError(
                f"{folder}: the pattern {pattern!r} cannot be used ({error}). Give one relative to the folder, "
                "like `day_1/*` or `**/*`."
            ) from None
    if not found:
        raise RecordingError(
            f"{folder}: no file matches {', '.join(patterns)} and ends in {', '.join(SUFFIXES)}. "
            "Change the patterns, or put the sessions there."
        )
    return sorted(found, key=lambda path: path.relative_to(folder).as_posix())


def sources(folder: Path) -> list[Path]:
    """The bags, tables and LeRobot data sets of a folder, by path; or the path itself, if it is one of these."""
    if is_bag(folder) or is_lerobot(folder) or folder.suffix.lower() in TABLES:
        return [folder]
    if not folder.is_dir():
        raise RecordingError(f"{folder}: there is no such bag, table or folder. Give the folder of the recordings.")
    found = [p for p in folder.rglob("*") if p.suffix.lower() in TABLES or is_bag(p) or is_lerobot(p)]
    # Files in the folder of a ROS 2 bag or of a data set are part of it.
    alone = [p for p in found if not any(is_bag(parent) or is_lerobot(parent) for parent in p.parents)]
    if not alone:
        raise RecordingError(
            f"{folder}: holds no MCAP file, ROS 2 bag, LeRobot data set, CSV or Parquet file. Give another folder."
        )
    return sorted(alone)


def mapping_file(path: Path) -> Path:
    """The path of the mapping file; ConfigError where there is none."""
    if not path.is_file():
        raise ConfigError(f"{path}: there is no such file. Give the mapping file (docs/tutorials/own_robot.md).")
    return path


def is_bag(path: Path) -> bool:
    """Whether it is an MCAP file, or a folder that a ROS 2 recorder wrote."""
    return path.suffix.lower() == ".mcap" or (path / "metadata.yaml").is_file()


def is_lerobot(path: Path) -> bool:
    """Whether it is the folder of a LeRobot data set."""
    return (path / "meta" / "info.json").is_file()
