"""Checks a schema: names and units of its fields, bodies, axes and mounts."""

from typing import Any, get_args

from simgap.loading.user_code import check_tuple, duplicates, shown
from simgap.types import Axis, ConfigError, Field, Frame, Kind, Schema

# The role of each kind on a body's axis; an axis may have each role once.
_STATE_ROLES = {"position": "position or angle", "angle": "position or angle", "velocity": "velocity"}
_COMMAND_ROLES = {"velocity": "velocity or force", "force": "velocity or force"}


def check_schema(schema: Any, name: str) -> None:
    """ConfigError that begins with `name` unless it is a valid schema: names, units, bodies, axes and mounts."""
    if not isinstance(schema, Schema):
        raise ConfigError(
            f"{name}: schema must be a simgap.types.Schema; it is {shown(schema)}. Write "
            "Schema(state=(Field(...), ...), command=(Field(...), ...))."
        )
    for what, fields in (("state", schema.state), ("command", schema.command)):
        check_tuple(fields, Field, "Field(...)", f"schema.{what}", name)
        for field in fields:
            _check_field(field, name)
    if not schema.state:
        raise ConfigError(
            f"{name}: schema.state must have at least one Field; it has none. What is not measured cannot be "
            "diagnosed: add the columns that its recordings have. (schema.command may be empty.)"
        )
    twice = duplicates(schema.columns)
    if twice:
        raise ConfigError(
            f"{name}: each of time_s and the fields must have a name of its own; {', '.join(twice)} is there more than "
            "once. Rename the field: a name is a column of the recordings."
        )
    _check_geometry(schema, name)


def _check_field(field: Field, name: str) -> None:
    if not isinstance(field.name, str) or not field.name:
        raise ConfigError(
            f"{name}: a Field's name must be a column's name; {field.name!r} is none. Write it as in the recordings."
        )
    for member, allowed in (("kind", get_args(Kind)), ("frame", get_args(Frame)), ("axis", get_args(Axis))):
        value = getattr(field, member)
        if value not in allowed:
            raise ConfigError(
                f"{name}: field {field.name}: {member} must be one of {', '.join(repr(a) for a in allowed)}; it is "
                f"{value!r}. Choose one of these."
            )
    if field.kind == "angle" and field.unit != "rad":
        raise ConfigError(
            f"{name}: field {field.name}: an angle must be in rad; its unit is {field.unit!r}. Convert it to rad in "
            "simulator and recordings."
        )
    if field.axis and not field.body:
        raise ConfigError(
            f"{name}: field {field.name}: an axis must come with the body that moves along it; the axis is "
            f"{field.axis!r} and the body is empty. Name the body, or leave both out."
        )


def _check_geometry(schema: Schema, name: str) -> None:
    """ConfigError unless each axis of a body has one field per role, and mounts join bodies that exist."""
    # In the order of their first state column, as in simgap.layout.
    bodies = list(dict.fromkeys(f.body for f in schema.state if f.body))
    known = ", ".join(bodies) or "none"
    for field in schema.command:
        if field.body and field.body not in bodies:
            raise ConfigError(
                f"{name}: field {field.name}: a command's body must be the body of a state too; {field.body!r} is not "
                f"(bodies of the state: {known}). Name one of them, or leave body and axis out."
            )
    for fields, roles in ((schema.state, _STATE_ROLES), (schema.command, _COMMAND_ROLES)):
        taken: dict[tuple[str, str, str], str] = {}
        for field in fields:
            if not field.body or not field.axis:
                continue
            key = (field.body, field.axis, roles.get(field.kind, field.kind))
            if key in taken:
                raise ConfigError(
                    f"{name}: fields {taken[key]} and {field.name}: a body must have one {key[2]} along an axis; both "
                    f"are of body {field.body!r}, axis {field.axis!r}. Give one of them its own body or axis, or leave "
                    "body and axis out."
                )
            taken[key] = field.name
    check_tuple(schema.mounts, tuple, "('hand', 'base')", "schema.mounts", name)
    for mount in schema.mounts:
        if len(mount) != 2 or not all(body in bodies for body in mount):
            raise ConfigError(
                f"{name}: a mount must be a pair (body, carrier) of bodies that the state names ({known}); "
                f"{mount!r} is none. Mend the names."
            )
        body, carrier = mount
        # Motions are computed carrier first; this also rules out circles.
        if bodies.index(carrier) >= bodies.index(body):
            raise ConfigError(
                f"{name}: a mount's carrier must come before the body it carries in schema.state; in {mount!r} "
                f"{carrier!r} does not. Move the carrier's fields to the front, or swap the pair (body, carrier)."
            )
    twice = duplicates(body for body, _ in schema.mounts)
    if twice:
        raise ConfigError(
            f"{name}: a body must be mounted on one carrier; {', '.join(twice)} is mounted more than once. Keep the "
            "carrier that turns it."
        )
