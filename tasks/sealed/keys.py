"""The keys of a sealed suite, opened by those who may know them: who scores, and who makes a prescribed experiment."""

from typing import Any

from concealed import seal
from simgap.formats.documents import read_bytes, read_json
from simgap.types import SimgapError
from tasks.sealed.workspace import SealedWorkspace


def opened(workspace: SealedWorkspace) -> tuple[dict[str, Any], dict[str, dict[str, Any]]]:
    """The manifest and the keys by case; SimgapError where they are not those whose hashes were published."""
    manifest = read_json(workspace.manifest)
    if read_json(workspace.published) != manifest:
        raise SimgapError(f"{workspace.published}: must be the manifest of the recordings, {workspace.manifest}.")
    try:
        return manifest, seal.unseal(read_bytes(workspace.sealed), read_bytes(workspace.secret), manifest["keys"])
    except seal.BrokenSealError as error:
        raise SimgapError(f"{workspace.sealed}: {error}") from None
