"""Compiled functions are forgotten before their maps of memory are more than a process may have."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from simgap import compiled


def maps() -> int:
    return len(compiled.MAPS.read_text(encoding="ascii").splitlines())


def test_many_are_forgotten_and_compiled_again(monkeypatch: pytest.MonkeyPatch) -> None:
    double = jax.jit(lambda x: 2 * jnp.sin(x) + x)
    kept = [jax.jit(lambda x, k=k: jnp.cumsum(x) * k) for k in range(30)]
    before = double(jnp.arange(4.0))
    for each in kept:
        each(jnp.arange(4.0))
    held = maps()
    assert not compiled.forget_if_many()
    monkeypatch.setattr(compiled, "FULL", 0.0)
    assert compiled.forget_if_many()
    assert maps() < held - 30
    np.testing.assert_array_equal(double(jnp.arange(4.0)), before)


def test_where_there_are_no_such_files_nothing_is_forgotten(monkeypatch: pytest.MonkeyPatch, tmp_path) -> None:
    monkeypatch.setattr(compiled, "MAPS", tmp_path / "maps")
    assert not compiled.forget_if_many()
