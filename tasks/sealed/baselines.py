"""What a user would otherwise take, on the same cases: a refit of the parameters, sparse regression, a black box."""

import warnings
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from jaxtyping import Float

from concealed.plain import V_BASE, V_EE, carried, turned
from tasks.sealed.judge import ONE, SEEN, Row

THRESHOLD = 0.1
"""pysindy's own: least coefficient that is kept, inputs and outputs in standard deviations."""
_AXES = ("base_vx", "base_vy", "base_wz", "ee_vx", "ee_vy", "ee_vz")


def sparse(state: Float[np.ndarray, "S T 12"], command: Float[np.ndarray, "S T 6"], key: Mapping[str, Any]) -> Row:
    """Whether sparse regression on the one-step residuals claims anything, and whether its greatest term is right.

    The 24 parameters are refitted by least squares on measured states, then the residuals' body-frame velocities are
    regressed on squares and products of velocities and commands by sequential thresholding [Brunton et al. 2016].
    """
    from pysindy import STLSQ  # a development dependency: only scoring needs it

    x, u = state[:, :-1].reshape(-1, 12), command[:, :-1].reshape(-1, 6)
    y = state[:, 1:].reshape(-1, 12)
    velocity, residual = _residuals(x, u, y)
    base = np.concatenate([velocity, u], axis=1)
    names = [*_AXES, *(f"cmd_{a}" for a in _AXES)]
    pairs = [(i, j) for i in range(12) for j in range(i, 12)]
    library = np.concatenate([base, np.stack([base[:, i] * base[:, j] for i, j in pairs], axis=1)], axis=1)
    terms = [(n,) for n in names] + [(names[i], names[j]) for i, j in pairs]
    used = library.std(0) > 1e-9
    library = (library[:, used] - library[:, used].mean(0)) / library[:, used].std(0)
    terms = [t for t, keep in zip(terms, used, strict=True) if keep]
    residual = (residual - residual.mean(0)) / residual.std(0)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # of sparse fits that keep nothing
        fitted = STLSQ(threshold=THRESHOLD, alpha=1e-3).fit(library, residual)
    weights = np.abs(np.atleast_2d(fitted.coef_))
    if not weights.any():
        return {"sindy_claims": False, "sindy_right": False}
    output, term = np.unravel_index(weights.argmax(), weights.shape)
    right = {i for e in key["effects"] for i in e["accept"]}
    return {"sindy_claims": True, "sindy_right": bool(meaning(_AXES[output], terms[term]) & right)}


def meaning(output: str, term: Sequence[str]) -> set[str]:
    """Ids that a term of the regression may be read as, generously."""
    own = f"cmd_{output}"
    if len(term) == 1:
        if term[0] == own:
            return {
                "gain",
                "delay",
                "lag",
                "saturation",
                "deadband",
                "asymmetric_gain",
                "rate_limit",
                "coulomb_friction",
            }
        if term[0] == output:
            return {"viscous_drag", "gain", "lag", "sensor_scale", "coulomb_friction", "integration_rule"}
        if term[0] == "base_wz" or term[0] == "cmd_base_wz":
            return {"rotation_centre", "frame_misalignment", "relative_smoothing"}
        return {"cross_axis_coupling", "frame_misalignment", "base_arm_coupling", "arm_base_coupling"}
    if set(term) <= {output, own}:
        return {"quadratic_drag", "asymmetric_gain", "saturation"}
    if set(term) <= {"base_wz", "cmd_base_wz"}:
        return {"centripetal"}
    return {"slip", "relative_smoothing", "slope"}


def _residuals(x: np.ndarray, u: np.ndarray, y: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Body-frame velocities, and what the plain model, fitted by least squares, leaves of the next row's velocities."""
    left = []
    base = turned(x[:, 2], u[:, :3])
    hand = turned(x[:, 2], u[:, 3:])
    moved = carried(y[:, V_BASE], x[:, 6:8] - x[:, 0:2])
    for i in range(3):
        left.append(_memory(x[:, V_BASE][:, i], base[:, i], y[:, V_BASE][:, i]))
    for i in range(3):
        left.append(_memory(x[:, V_EE][:, i], hand[:, i], y[:, V_EE][:, i] - moved[:, i]))
    residual = np.stack(left, axis=1)
    to_body = lambda v: np.concatenate([turned(-x[:, 2], v[:, :3]), turned(-x[:, 2], v[:, 3:])], axis=1)  # noqa: E731
    return to_body(np.concatenate([x[:, V_BASE], x[:, V_EE]], axis=1)), to_body(residual)


def _memory(v: np.ndarray, u: np.ndarray, new: np.ndarray) -> np.ndarray:
    """new - (alpha v + (1 - alpha) u + beta), by least squares in alpha and beta."""
    inputs = np.stack([v - u, np.ones_like(v)], axis=1)
    solution, *_ = np.linalg.lstsq(inputs, new - u, rcond=None)
    return new - u - inputs @ solution


def table(rows: Sequence[Row]) -> list[dict[str, Any]]:
    """Scores of the diagnosis and of the methods it is compared with: sparse regression for the Spot alone."""
    nulls = [r for r in rows if r["kind"] == "null"]
    known = [r for r in rows if r["kind"] in ONE and r["strength"] >= SEEN]
    mean = lambda values: float(np.mean(values)) if len(values) else np.nan  # noqa: E731
    wrong = lambda name: mean([r[name] for r in nulls])  # noqa: E731
    right = lambda name: mean([r[name] for r in known])  # noqa: E731
    shares = lambda name: _median([r[name] for r in rows if name in r])  # noqa: E731
    ours = {"method": "diagnosis", "false alarms on nulls": 1 - wrong("right_verdict"),
            "right name": right("top1"), "share of improvement, 50 steps": shares("share")}  # fmt: skip
    refit = {"method": "refit of the parameters", "false alarms on nulls": 0.0, "right name": 0.0,
             "share of improvement, 50 steps": 0.0}  # fmt: skip
    methods = [ours, refit]
    if any("sindy_claims" in r for r in rows):
        methods.append({"method": "sparse regression (pysindy)", "false alarms on nulls": wrong("sindy_claims"),
                        "right name": right("sindy_right"), "share of improvement, 50 steps": np.nan})  # fmt: skip
    box = {"method": "black box", "false alarms on nulls": np.nan, "right name": 0.0,
           "share of improvement, 50 steps": shares("share_black_box")}  # fmt: skip
    return [*methods, box]


def of_arms(rows: Sequence[Row]) -> list[dict[str, Any]]:
    """The same for arms: the model as it is, MuJoCo's toolbox (tasks/sealed/sysid.py) and the diagnosis.

    Open-loop errors are medians, in the noise of positions. A parameter that is right is moved if it changed by more
    than a tenth.
    """
    fitted = [r for r in rows if "sysid_moved" in r]
    nulls = [r for r in fitted if r["kind"] == "null"]
    concealed = [r for r in fitted if r["kind"] not in ("null", "parameters")]

    def of(method: str, open_loop: str, moved: str = "", friction: str = "") -> dict[str, Any]:
        error = lambda some: _median([r[open_loop] for r in some if open_loop in r])  # noqa: E731
        share = lambda some: float(np.mean([r.get(moved, 0) > 0 for r in some])) if some else np.nan  # noqa: E731
        return {"method": method, "open-loop error on nulls": error(nulls),
                "open-loop error with an effect": error(concealed),
                "nulls with a right parameter moved": share(nulls), "cases with an effect, likewise": share(concealed),
                "joints with invented friction": sum(r.get(friction, 0) for r in fitted)}  # fmt: skip

    return [of("the model as it is", "open_loop_nominal"),
            of("mujoco.sysid, all parameters", "sysid_open_loop", "sysid_moved", "sysid_friction"),
            of("diagnosis", "open_loop", "moved", "friction")]  # fmt: skip


def _median(values: Sequence[float]) -> float:
    """Of those that are numbers; nan where none is."""
    found = [v for v in values if not np.isnan(v)]
    return float(np.median(found)) if found else np.nan
