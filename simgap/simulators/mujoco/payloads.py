"""Where a load would be carried: at the end of each chain of links. A body without mass is added there to take it."""

# pyright: reportAttributeAccessIssue=false
# MuJoCo's names are native, and unknown to type checkers.
import re

import mujoco
import numpy as np

from simgap.simulators.mujoco.machine import Machine

PREFIX = "added_load_"
"""Begins the name of a body that is added; the rest is the name of the body that carries it."""
_TOOLS = ("grip", "tool", "tcp", "eef", "pinch", "grasp", "flange", "attach", "hand", "tip", "endeff")
"""How the names of sites at which a robot holds something begin."""


def places(model: mujoco.MjModel, machine: Machine) -> dict[str, tuple[float, float, float]]:
    """Bodies that would carry a load, and where in their frames [m] its centre would be.

    A site that is named like a tool is taken where the chain has one. Else it is the last link, or the hand where the
    last ones are fingers, at twice the distance of its centre of mass: the far end of a uniform rod.
    """
    moving = _moving(model, machine)
    parents = {b: int(model.body_weldid[model.body_parentid[b]]) for b in moving}
    found: dict[str, tuple[float, float, float]] = {}
    for leaf in (b for b in moving if b not in parents.values()):
        site = _tool(model, leaf, parents)
        if site is not None:
            body, centre = int(model.site_bodyid[site]), model.site_pos[site]
        else:
            body = _hand(leaf, parents)
            centre = 2 * model.body_ipos[body]
        x, y, z = map(float, centre)
        found.setdefault(model.body(body).name, (x, y, z))
    return found


def add(spec: mujoco.MjSpec, name: str, carrier: str, centre: tuple[float, float, float], mass: float) -> None:
    """Add a point mass [kg] to a body, as a body of its own."""
    body = spec.body(carrier).add_body(name=name, pos=centre, mass=mass, explicitinertial=True)
    body.ipos, body.iquat = [0.0, 0.0, 0.0], [1.0, 0.0, 0.0, 0.0]  # MuJoCo would put it at `pos` once more


def upstream(model: mujoco.MjModel, body: int) -> set[int]:
    """The degrees of freedom that move a body."""
    found: set[int] = set()
    while body:
        first = int(model.body_dofadr[body])
        found |= set(range(first, first + int(model.body_dofnum[body]))) if first >= 0 else set()
        body = int(model.body_parentid[body])
    return found


def _moving(model: mujoco.MjModel, machine: Machine) -> list[int]:
    """The first bodies of groups of welded bodies that diagnosed joints or their followers move."""
    dofs = {j.dof for j in machine.joints} | {f.dof for f in machine.followers}
    return [b for b in range(1, model.nbody) if model.body_weldid[b] == b and upstream(model, b) & dofs]


def _tool(model: mujoco.MjModel, leaf: int, parents: dict[int, int]) -> int | None:
    """The site at which the chain that ends in this body holds things."""
    body = leaf
    while body in parents:
        for site in np.flatnonzero(model.body_weldid[model.site_bodyid] == body):
            words = re.split(r"[^a-z]+", model.site(int(site)).name.lower())
            if any(w == "ee" or w.startswith(_TOOLS) for w in words):
                return int(site)
        body = parents[body]
    return None


def _hand(leaf: int, parents: dict[int, int]) -> int:
    """The body that carries this one, where it carries several and these carry nothing: fingers."""
    parent = parents[leaf]
    siblings = [b for b, p in parents.items() if p == parent]
    fingers = len(siblings) > 1 and not any(b in parents.values() for b in siblings)
    return parent if fingers and parent in parents else leaf
