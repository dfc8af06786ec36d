"""The code of docs/how_to/mujoco.md runs, and says what the page says it does."""

import ast
import re
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pytest
from scipy.spatial.transform import Rotation

from examples.arm import ArmConfig, arm_session, schema
from simgap.simulators.mujoco import MujocoEngine, load
from simgap.types import Recording

ROOT = Path(__file__).parents[4]
PAGE = (ROOT / "docs" / "how_to" / "mujoco.md").read_text()


def test_the_code_of_the_page_runs(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(ROOT)
    states, commands = arm_session(np.random.default_rng(0), 100, ArmConfig())
    names: dict[str, Any] = {
        "table": pd.DataFrame({"time_s": [0.0, 0.1]}),
        "quaternions": Rotation.from_euler("ZYX", [[0.3, 0.2, 0.1], [-3, 1, 2]]).as_quat(),
        "recordings": [Recording("one", np.arange(100) * 0.02, states, commands)],
        "recordings_columns": schema(speeds=True).columns,
    }
    for code in re.findall(r"```python\n(.*?)```", PAGE, re.DOTALL):
        exec(compile(ast.parse(code), "docs/how_to/mujoco.md", "exec"), names)
    engine, patched = names["engine"], names["patched"]
    assert isinstance(engine, MujocoEngine)
    assert engine.words(names["phi"])[0] == "kp pan: 60 -> 42 N m/rad"
    np.testing.assert_allclose(names["table"].iloc[:, 1:], [[0.3, 0.2, 0.1], [-3, 1, 2]])
    assert [str(c) for c in patched.changes] == ["actuator pan: kp 60 -> 42", "actuator elbow: delay 0 -> 0.03"]


def test_every_term_and_parameter_is_in_the_table_of_the_page() -> None:
    engine = load(ROOT / "examples" / "arm.xml", 0.02)
    for term in engine.terms:
        assert f"`{term.effect}`" in PAGE
    for parameter in engine.parameters:
        assert f"`{parameter.name.split()[0]} <" in PAGE
