"""A MuJoCo model as the engine of a diagnosis: many rows at once, parameters as scales, terms that switch on."""

# pyright: reportAttributeAccessIssue=false
# MuJoCo's names are native code, unknown to type checkers.
import copy
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, replace
from functools import cached_property

import mujoco
import numpy as np
from jaxtyping import Float
from mujoco import rollout

from simgap.engines import Term
from simgap.simulators.mujoco.attributes import WIDE, WIDE_IF_FAR, Scaled
from simgap.simulators.mujoco.changing import apply, arrays
from simgap.simulators.mujoco.machine import Machine
from simgap.simulators.mujoco.reading import Source
from simgap.simulators.mujoco.split import deflecting
from simgap.simulators.mujoco.terms import Switch
from simgap.types import Parameter, Schema

CHUNK = 2048
"""Rows that are stepped in one batch; all their substeps are in memory."""
_FULL = int(mujoco.mjtState.mjSTATE_FULLPHYSICS)
_INPUTS = int(mujoco.mjtState.mjSTATE_CTRL) | int(mujoco.mjtState.mjSTATE_QFRC_APPLIED)


@dataclass(frozen=True)
class _Worker:
    """What one thread at a time steps with: its own copy of the model, and MuJoCo's working memory."""

    model: mujoco.MjModel
    data: mujoco.MjData
    roll: rollout.Rollout


@dataclass(frozen=True, eq=False)
class MujocoEngine:
    """A model that a diagnosis can step, as an `Engine`.

    source: the model as it was read. model: compiled, with a massless body for each payload; never changed.
    time_step: nominal interval between rows [s]. steps: MuJoCo's steps per row. parts: parts of a row in which commands
    may differ. rough_steps: steps per row of `rough`. scaled, switches: what the parameters and the terms change.
    nominal: the parameters from which a search starts; zero for the model as it is. given: the engine of the model as
    it is, if the search starts elsewhere.
    """

    source: Source
    model: mujoco.MjModel
    machine: Machine
    time_step: float
    steps: int
    parts: int
    rough_steps: int
    scaled: tuple[Scaled, ...]
    switches: tuple[Switch, ...]
    nominal: Float[np.ndarray, " p"]
    given: "MujocoEngine | None" = None

    @cached_property
    def schema(self) -> Schema:
        """The columns of its recordings, and the states that these lack."""
        return self.machine.schema

    @cached_property
    def parameters(self) -> tuple[Parameter, ...]:
        """What the model sets, as logarithms of scales on the model's values."""
        wide = WIDE if self.given is None else WIDE_IF_FAR
        return tuple(s.parameter(float(value), wide) for s, value in zip(self.scaled, self.nominal, strict=True))

    @cached_property
    def terms(self) -> tuple[Term, ...]:
        """What the model leaves at zero."""
        return tuple(s.term for s in self.switches)

    @property
    def notes(self) -> tuple[str, ...]:
        """Parts of the model that are left out or cannot be diagnosed, in words."""
        return (*self.source.notes, *self.machine.notes)

    @cached_property
    def rough(self) -> "MujocoEngine":
        """The engine with fewer, longer steps: its derivatives are as good, and cost less."""
        if self.rough_steps == self.steps:
            return self
        model = copy.copy(self.model)
        model.opt.timestep = self.time_step / self.rough_steps
        return replace(self, model=model, steps=self.rough_steps)

    def split(self, joint: str) -> "tuple[MujocoEngine, ...]":
        """Rivals with play or a spring between motor and link of a joint; see `engines.split_of`."""
        return deflecting(self, joint)

    def words(self, phi: Float[np.ndarray, " p"]) -> list[str]:
        """The model's parameters and the fitted ones, in physical units."""
        return [s.words(float(value)) for s, value in zip(self.scaled, phi, strict=True)]

    def rows(
        self,
        phi: Float[np.ndarray, " p"],
        terms: Float[np.ndarray, "n k"],
        state: Float[np.ndarray, "n s"],
        command: Float[np.ndarray, "n parts u"],
        effort: Float[np.ndarray, "n a"],
    ) -> Float[np.ndarray, "n s"]:
        """The next states; see `Engine`. Rows with equal terms are stepped together."""
        state = np.asarray(state, float)
        command = np.repeat(np.asarray(command, float), self.steps // self.parts, axis=1)
        terms, effort = np.asarray(terms, float), np.asarray(effort, float)
        after = np.empty_like(state)
        kinds, kind = np.unique(terms, axis=0, return_inverse=True)
        with self._worker() as worker:
            for k, values in enumerate(kinds):
                apply(self, worker.model, worker.data, phi, values)
                at = np.flatnonzero(kind.ravel() == k)
                for rows in np.split(at, range(CHUNK, len(at), CHUNK)):
                    ends = self._roll(worker, state[rows], command[rows], effort[rows], self.steps)
                    after[rows] = ends[:, 0]
        return after

    def path(
        self,
        phi: Float[np.ndarray, " p"],
        terms: Float[np.ndarray, " k"],
        start: Float[np.ndarray, " s"],
        command: Float[np.ndarray, "T u"],
    ) -> Float[np.ndarray, "T s"]:
        """The states in open loop, the start first. Commands are held for a row; the last one is not used."""
        held = np.repeat(np.asarray(command, float)[:-1], self.steps, axis=0)
        no_effort = np.zeros((1, len(self.machine.joints)))
        with self._worker() as worker:
            apply(self, worker.model, worker.data, phi, terms)
            states = self._roll(worker, np.asarray(start, float)[None], held[None], no_effort, self.steps)[0]
        return np.vstack([start, states])

    def compiled(self, phi: Float[np.ndarray, " p"], terms: Float[np.ndarray, " k"]) -> mujoco.MjModel:
        """A new model with these parameters and terms, which the caller may change."""
        model = copy.copy(self.model)
        apply(self, model, mujoco.MjData(model), phi, terms)
        return model

    @cached_property
    def changed(self) -> tuple[str, ...]:
        """Names of the model's arrays that parameters or terms change."""
        return arrays(self.scaled, self.switches)

    @cached_property
    def _idle(self) -> list[_Worker]:
        """Workers that no thread uses now. None belongs to a thread, as a callback's thread ends with each call."""
        return []

    @contextmanager
    def _worker(self) -> Iterator[_Worker]:
        """A worker for this thread alone, within the `with` block."""
        try:
            worker = self._idle.pop()
        except IndexError:
            model = copy.copy(self.model)
            worker = _Worker(model, mujoco.MjData(model), rollout.Rollout(nthread=0))
        try:
            yield worker
        finally:
            self._idle.append(worker)

    @cached_property
    def _rest(self) -> Float[np.ndarray, " full"]:
        """MuJoCo's full state at the reference."""
        data = mujoco.MjData(self.model)
        data.qpos[:] = self.machine.reference
        full = np.empty(mujoco.mj_stateSize(self.model, _FULL))
        mujoco.mj_getState(self.model, data, full, _FULL)
        return full

    @cached_property
    def _columns(self) -> Float[np.ndarray, " s"]:
        """Index in MuJoCo's full state of each state of the schema."""
        qpos, qvel, act = (self._offset(part) for part in ("QPOS", "QVEL", "ACT"))
        joints = {j.name: j for j in self.machine.joints}
        columns = []
        for field in self.schema.state:
            if field.kind in ("position", "angle"):
                columns.append(qpos + joints[field.body].qpos)
            elif field.kind == "velocity":
                columns.append(qvel + joints[field.body].dof)
        columns += [act + a.act for a in self.machine.actuators if a.act is not None]
        split = self.machine.deflection
        return np.array(columns if split is None else [*columns, qpos + split.qpos, qvel + split.dof])

    @cached_property
    def _shown(self) -> Float[np.ndarray, "s s"]:
        """What the states of the schema are of MuJoCo's: `states = columns @ shown`."""
        shown, split = np.eye(len(self.schema.state)), self.machine.deflection
        if split is not None:
            shown[-1, -1] = self.time_step
            names = [f.name for f in self.schema.state]
            joint = self.machine.joints[split.joint].name
            if split.at_link:
                shown[[-2, -1], [names.index(f"{joint}_pos"), names.index(f"{joint}_vel")]] = 1.0
        return shown

    def _offset(self, part: str) -> int:
        """Index in MuJoCo's full state at which a part of it begins: parts come in the order of their bits."""
        before = int(getattr(mujoco.mjtState, f"mjSTATE_{part}")) - 1
        return mujoco.mj_stateSize(self.model, _FULL & before)

    @cached_property
    def _forced(self) -> list[int]:
        """The degrees of freedom of the velocities with an `effort`, in the order of the states."""
        joints = {j.name: j for j in self.machine.joints}
        return [joints[f.body].dof for f in self.schema.state if f.effort]

    def _roll(
        self,
        worker: _Worker,
        state: Float[np.ndarray, "n s"],
        command: Float[np.ndarray, "n t u"],
        effort: Float[np.ndarray, "n a"],
        every: int,
    ) -> Float[np.ndarray, "n t/every s"]:
        """The states after each `every` steps; NaN from where MuJoCo gave up."""
        full = np.tile(self._rest, (len(state), 1))
        full[:, self._columns] = np.linalg.solve(self._shown.T, state.T).T
        self._follow(full)
        inputs = np.zeros((*command.shape[:2], self.model.nu + self.model.nv))
        inputs[..., : self.model.nu] = self.machine.controls
        inputs[..., [a.control for a in self.machine.actuators]] = command
        inputs[..., [self.model.nu + d for d in self._forced]] = effort[:, None]
        states = np.empty((*command.shape[:2], full.shape[1]))
        worker.roll.rollout(worker.model, worker.data, full, inputs, control_spec=_INPUTS, state=states)
        taken = states[:, every - 1 :: every]
        # When MuJoCo gives up on a row, its time stands still or restarts at zero.
        timestep = worker.model.opt.timestep
        clock = self._rest[0] + timestep * np.arange(every, command.shape[1] + 1, every)
        lost = np.abs(taken[..., 0] - clock) > timestep / 2
        return np.where(lost[..., None], np.nan, taken[..., self._columns] @ self._shown)

    def _follow(self, full: Float[np.ndarray, "n full"]) -> None:
        """Put joints that follow others where the equality constraint requires."""
        qpos, qvel = self._offset("QPOS"), self._offset("QVEL")
        for follower in self.machine.followers:
            leader = self.machine.joints[follower.leader]
            polynomial = np.polynomial.Polynomial(follower.polynomial)
            offset = full[:, qpos + leader.qpos] - self.model.qpos0[leader.qpos]
            full[:, qpos + follower.qpos] = self.model.qpos0[follower.qpos] + polynomial(offset)
            full[:, qvel + follower.dof] = polynomial.deriv()(offset) * full[:, qvel + leader.dof]
