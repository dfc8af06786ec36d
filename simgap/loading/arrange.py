"""The sessions that a simulator is diagnosed on, and what of a model file is left out because of them."""

from collections.abc import Callable

from simgap.formats import purposes
from simgap.formats.purposes import Purposes
from simgap.formats.rates import in_other_units
from simgap.loading.load import Used
from simgap.loading.model_files import recalled
from simgap.survey import sentence
from simgap.types import Sessions


def arranged(used: Used, given: Purposes, say: Callable[[str], None]) -> tuple[Used, Sessions]:
    """The simulator for these sessions, and the sessions by purpose; `say` gets what of a model file is left out.

    A joint of a model file whose velocity has other units than its position is left out, as if neither were recorded.
    Raises RecordingError as `purposes.arranged` does: it also names such columns if the simulator is no model file, so
    that its columns are fixed, or if no joint would be left.
    """
    used, given = _without_other_units(used, given)
    for note in used.notes:
        say(note)
    return used, purposes.arranged(used.simulator, given)


def _without_other_units(used: Used, given: Purposes) -> tuple[Used, Purposes]:
    """Both without the joints of a model file whose velocity has other units than their position."""
    if used.model_file is None:
        return used, given
    schema = used.simulator.schema
    wrong = [(part, *found) for part in given.every for found in in_other_units(used.simulator, part.sessions).items()]
    columns = {name for _, velocity, k in wrong for name in (velocity, k.position)}
    if not wrong or columns == {f.name for f in schema.outputs}:
        return used, given
    joints = {f.name: f.body for f in schema.state}
    notes: dict[str, str] = {}
    for part, velocity, k in wrong:  # a joint may be wrong for several purposes: one is enough to say
        notes.setdefault(velocity, f"the joint {joints[velocity]} is left out, as if its columns were not recorded: in "
                                   f"{part.label}, {sentence(velocity, k)}")  # fmt: skip
    kept = used.model_file | {"columns": tuple(name for name in used.model_file["columns"] if name not in columns)}
    # The sessions are not read again: they may be large.
    engine = recalled(kept)
    return Used(engine, used.name, kept, tuple(notes.values())), given.narrowed(schema, engine.schema)
