"""Compiled functions are forgotten before their maps of memory are more than a process may have."""

from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from simgap import compiled


def maps() -> int:
    return len(compiled.MAPS.read_text(encoding="ascii").splitlines())


def test_many_are_forgotten_and_compiled_again(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    double = jax.jit(lambda x: 2 * jnp.sin(x) + x)
    kept = [jax.jit(lambda x, k=k: jnp.cumsum(x) * k) for k in range(30)]
    before = double(jnp.arange(4.0))
    for each in kept:
        each(jnp.arange(4.0))
    # What other tests compiled in this process counts as well, so the limit is relative to what it holds now.
    held, allowed = maps(), tmp_path / "max_map_count"
    monkeypatch.setattr(compiled, "LIMIT", allowed)
    allowed.write_text(f"{round(1.2 * held / compiled.FULL)}\n")
    assert not compiled.forget_if_many()
    allowed.write_text(f"{round(0.8 * held / compiled.FULL)}\n")
    assert compiled.forget_if_many()
    assert maps() < held - 30
    np.testing.assert_array_equal(double(jnp.arange(4.0)), before)


def test_where_there_are_no_such_files_nothing_is_forgotten(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.setattr(compiled, "MAPS", tmp_path / "maps")
    assert not compiled.forget_if_many()
