"""Places for payloads: the end of each chain of links. A massless body is added there, to which a term gives mass."""

# pyright: reportAttributeAccessIssue=false
# MuJoCo's names are native code, unknown to type checkers.
import re

import mujoco
import numpy as np

from simgap.simulators.mujoco.machine import Machine

PREFIX = "added_load_"
"""Prefix of the name of an added body; the rest is the name of the body that carries it."""
_TOOLS = ("grip", "tool", "tcp", "eef", "pinch", "grasp", "flange", "attach", "hand", "tip", "endeff")
"""Beginnings of words in the names of sites at which a robot holds something."""


def places(model: mujoco.MjModel, machine: Machine) -> dict[str, tuple[float, float, float]]:
    """Bodies that would carry a payload, and the position of its centre in their frames [m].

    A site that is named like a tool is taken where the chain has one. Otherwise it is the last link (the hand, where
    the last links are fingers), at twice its centre of mass: the far end of a uniform rod.
    """
    moving = _moving(model, machine)
    parents = {b: int(model.body_weldid[model.body_parentid[b]]) for b in moving}
    centres: dict[str, tuple[float, float, float]] = {}
    for leaf in (b for b in moving if b not in parents.values()):
        site = _tool(model, leaf, parents)
        if site is not None:
            body, centre = int(model.site_bodyid[site]), model.site_pos[site]
        else:
            body = _hand(leaf, parents)
            centre = 2 * model.body_ipos[body]
        x, y, z = map(float, centre)
        centres.setdefault(model.body(body).name, (x, y, z))
    return centres


def add(spec: mujoco.MjSpec, name: str, carrier: str, centre: tuple[float, float, float], mass: float) -> None:
    """Add a point mass [kg] to a body, as a body of its own."""
    body = spec.body(carrier).add_body(name=name, pos=centre, mass=mass, explicitinertial=True)
    body.ipos, body.iquat = [0.0, 0.0, 0.0], [1.0, 0.0, 0.0, 0.0]  # otherwise MuJoCo adds `pos` a second time


def upstream(model: mujoco.MjModel, body: int) -> set[int]:
    """The degrees of freedom that move a body."""
    dofs: set[int] = set()
    while body:
        first = int(model.body_dofadr[body])
        dofs |= set(range(first, first + int(model.body_dofnum[body]))) if first >= 0 else set()
        body = int(model.body_parentid[body])
    return dofs


def _moving(model: mujoco.MjModel, machine: Machine) -> list[int]:
    """The first body of each group of welded bodies that diagnosed joints or their followers move."""
    dofs = {j.dof for j in machine.joints} | {f.dof for f in machine.followers}
    return [b for b in range(1, model.nbody) if model.body_weldid[b] == b and upstream(model, b) & dofs]


def _tool(model: mujoco.MjModel, leaf: int, parents: dict[int, int]) -> int | None:
    """The site at which the chain that ends in this body holds something; None if there is none."""
    body = leaf
    while body in parents:
        for site in np.flatnonzero(model.body_weldid[model.site_bodyid] == body):
            words = re.split(r"[^a-z]+", model.site(int(site)).name.lower())
            if any(w == "ee" or w.startswith(_TOOLS) for w in words):
                return int(site)
        body = parents[body]
    return None


def _hand(leaf: int, parents: dict[int, int]) -> int:
    """The body itself; its parent where that carries several bodies that carry nothing, which are fingers."""
    parent = parents[leaf]
    siblings = [b for b, p in parents.items() if p == parent]
    fingers = len(siblings) > 1 and not any(b in parents.values() for b in siblings)
    return parent if fingers and parent in parents else leaf
