"""Sealed keys: bound by their hashes, closed without the secret; and recordings that give nothing away."""

import os
from pathlib import Path

import numpy as np
import pytest

from concealed import seal, sessions, suite
from concealed.case import SIZES
from concealed.catalogue import FORMS, OUTSIDE
from concealed.suite import DUELS, LOCAL, MIXED, Config

KEYS = {"a": {"kind": "null", "strength": 0.0}, "b": {"kind": "single", "strength": 3.5}}
SALTS = {"a": "00ff", "b": "11ee"}
PUBLISHED = {name: seal.digest(key, SALTS[name]) for name, key in KEYS.items()}
WHOLE = Config(nulls=200, effects=tuple(FORMS), strengths=(3.0, 10.0, 30.0, 100.0, 300.0), duel_strengths=(10.0, 100.0),
               pairs=20, triples=12, regimes=12, onsets=16, outside_strengths=(30.0, 100.0, 300.0), parts=8,
               few=0.15, poor=0.1, glitches=0.1)  # fmt: skip


def test_keys_open_with_their_secret_alone() -> None:
    secret = seal.secret()
    closed = seal.seal(KEYS, SALTS, secret)
    assert seal.unseal(closed, secret, PUBLISHED) == KEYS
    assert b"single" not in closed
    with pytest.raises(seal.BrokenSealError, match="another suite"):
        seal.unseal(closed, seal.secret(), PUBLISHED)


def test_a_key_that_is_not_the_published_one_is_refused() -> None:
    secret = seal.secret()
    other = {**KEYS, "b": {"kind": "null", "strength": 0.0}}
    with pytest.raises(seal.BrokenSealError, match="1 keys"):
        seal.unseal(seal.seal(other, SALTS, secret), secret, PUBLISHED)


def test_equal_keys_with_other_salts_have_other_hashes() -> None:
    assert seal.digest(KEYS["a"], "00") != seal.digest(KEYS["a"], "01")


def test_the_suite_has_all_that_it_should() -> None:
    parts = suite.recipes(WHOLE, False, np.random.default_rng(0))
    cases = [r for part in parts for r in part]
    of = lambda kind: [r for r in cases if r.kind == kind]  # noqa: E731
    assert len(of("null")) == 200
    assert sorted(r.names[0] for r in of("single")) == sorted([*FORMS] * 5)
    assert {r.names[0] for r in of("duel")} == {e for d in DUELS for e in d}
    assert {r.names[0] for r in of("outside")} == set(OUTSIDE)
    assert all(len(set(r.names)) == n for kind, n in (("pair", 2), ("triple", 3)) for r in of(kind))
    assert {*LOCAL, *MIXED} <= set(FORMS)
    assert {r.one_session for r in of("onset")} == {True, False}
    for part in parts:  # stratified
        assert len([r for r in part if r.kind == "null"]) == 25
        assert abs(len(part) - len(cases) / 8) < 5


@pytest.fixture(scope="module")
def written(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, dict[str, int]]:
    """A part of a suite as files, with numbers of any size in them, and whether something is concealed in each."""
    folder = tmp_path_factory.mktemp("cases")
    recipes = [r for part in suite.recipes(WHOLE, False, np.random.default_rng(1))[:3] for r in part]
    names = suite.names(len(recipes), np.random.default_rng(2))
    rng, label = np.random.default_rng(3), {}
    for name, recipe in sorted(zip(names, recipes, strict=True)):
        count, rows = SIZES[recipe.size]
        # More is moved where something is concealed: were the width of numbers free, sizes would tell.
        scale = 0.01 if recipe.kind == "null" else 50.0
        sessions.write(folder / name, scale * rng.normal(size=(count, rows, 12)), rng.normal(size=(count, rows, 6)))
        label[name] = int(recipe.kind != "null")
    return folder, label


def outside_of(folder: Path) -> list[float]:
    """All that a case shows without being read."""
    files = sorted(folder.iterdir())
    stats = [f.stat() for f in files]
    rows = [sum(1 for _ in f.open()) for f in files]
    return [int(folder.name, 16), len(files), sum(rows), rows[0], sum(s.st_size for s in stats), stats[0].st_size,
            stats[-1].st_mtime, folder.stat().st_mtime, stats[0].st_mode]  # fmt: skip


def test_name_size_counts_order_and_times_tell_nothing(written: tuple[Path, dict[str, int]]) -> None:
    """A guesser (nearest neighbours) that learns from two thirds of the cases is at chance on the others."""
    folder, label = written
    seen = np.array([[*outside_of(folder / n), i] for i, n in enumerate(os.listdir(folder))])  # in the folder's order
    y = np.array([label[n] for n in os.listdir(folder)])
    spread = seen.std(0)
    x = seen[:, spread > 0] / spread[spread > 0]
    fold = np.arange(len(y)) % 3
    right = 0
    for k in range(3):
        train, test = fold != k, fold == k
        near = np.argsort(((x[test][:, None] - x[train]) ** 2).sum(-1), axis=1)[:, :7]
        right += int((np.round(y[train][near].mean(1)) == y[test]).sum())
    most = max(y.mean(), 1 - y.mean())
    sd = np.sqrt(most * (1 - most) * len(y))
    assert right < most * len(y) + 3 * sd
    # The size of a file is its number of rows and nothing else.
    sizes = {(len(f.read_text().splitlines()), f.stat().st_size) for c in folder.iterdir() for f in c.iterdir()}
    assert len(sizes) == len({rows for rows, _ in sizes}) == 2
    assert {f.stat().st_mtime for c in folder.iterdir() for f in (c, *c.iterdir())} == {sessions.EPOCH}


def test_a_guesser_finds_what_does_leak(written: tuple[Path, dict[str, int]]) -> None:
    """The guesser is not blind: numbers inside, which are there to be read, tell it all."""
    folder, label = written
    spread = {n: np.abs(sessions.read(folder / n)[0]).mean() for n in label}
    assert max(s for n, s in spread.items() if not label[n]) < min(s for n, s in spread.items() if label[n])


def test_what_is_written_is_read_again(tmp_path: Path) -> None:
    rng = np.random.default_rng(0)
    measured, command = rng.normal(size=(4, 30, 12)), rng.normal(size=(4, 30, 6))
    sessions.write(tmp_path / "case", measured, command)
    again = sessions.read(tmp_path / "case")
    np.testing.assert_allclose(again[0], measured, atol=1e-6)
    np.testing.assert_allclose(again[1], command, atol=1e-6)
