"""Parameters of the sealed suites: what is concealed, how it is examined and scored."""

from collections.abc import Mapping
from pathlib import Path
from typing import Any, Literal

from pydantic import Field

from tasks.params import FolderParams, read
from tasks.ranges import (
    MOST_VALUES,
    Cases,
    Dpi,
    Part,
    Parts,
    Patience,
    Seed,
    SessionFiles,
    SessionRows,
    Share,
    Strength,
    Strict,
    Workers,
)


class ArmParams(Strict):
    """What the suite of arms holds."""

    nulls: Cases = Field(description="Cases without an effect.")
    repeats: Cases = Field(description="Cases of every cause.")
    causes: list[str] = Field(description="By what a person would say; empty: all there are.")
    parts: Parts = Field(description="Stratified samples that the suite is dealt out into.")
    sessions: SessionFiles = Field(description="Sessions of a case, which are files from a to z.")
    rows: SessionRows = Field(description="Rows of a session, 50 a second.")


class KindsParams(Strict):
    """What the suite of machines of five kinds holds."""

    nulls: Cases = Field(description="Cases without an effect, of every kind.")
    repeats: Cases = Field(description="Cases of every cause.")
    parts: Parts = Field(description="Stratified samples that the suite is dealt out into.")
    sessions: SessionFiles = Field(description="Sessions of a case, which are files from a to z.")
    rows: SessionRows = Field(description="Rows of a session.")


class TiesParams(Strict):
    of: Literal["development", "examination"] = Field(description="The examined suite whose ties are settled.")
    repeats: SessionFiles = Field(description="Sessions of each experiment, from different places.")


class ConcealParams(Strict):
    """What a suite holds; counts of cases, strengths in nats."""

    seed: Seed = Field(description="Seed of the development suite; an examination's comes from the diagnosing code.")
    round: Cases = Field(description="Which examination of the same code.")
    nulls: Cases = Field(description="Cases without an effect.")
    effects: list[str] = Field(description="Ids of single effects; empty: all there are.")
    strengths: list[Strength] = Field(max_length=MOST_VALUES, description="A case of every effect at each.")
    duel_strengths: list[Strength] = Field(
        max_length=MOST_VALUES, description="A case of both sides of every pair that is easily confused."
    )
    pairs: Cases = Field(description="Cases of two effects.")
    triples: Cases = Field(description="Cases of three effects.")
    regimes: Cases = Field(description="Effects that act in a regime only.")
    onsets: Cases = Field(description="Effects that act from a time on only.")
    outside_strengths: list[Strength] = Field(
        max_length=MOST_VALUES, description="A case of every law outside the vocabulary at each."
    )
    parts: Parts = Field(description="Stratified samples that the suite is dealt out into.")
    few: Share = Field(description="Of all cases: few data.")
    poor: Share = Field(description="Of all cases: poor excitation.")
    glitches: Share = Field(description="Of all cases: glitches in what is measured.")
    real: FolderParams = Field(description="Recordings of a real Spot, for the suite of that name.")
    arm: ArmParams = Field(description="The suite of that name.")
    kinds: KindsParams = Field(description="The suite of that name.")
    ties: TiesParams = Field(description="The suite of that name.")


class ExamineParams(Strict):
    parts: list[Part] = Field(max_length=MOST_VALUES, description="Parts of the suite to be diagnosed; empty: all.")
    workers: Workers = Field(description="Processes that diagnose.")
    seed: Seed = Field(description="Seed of what the diagnosis draws.")
    patience_s: Patience = Field(description="Time after which a diagnosis is given up [s].")


class SealedScoreParams(Strict):
    seed: Seed = Field(description="Seed of bootstrap intervals.")
    figure_dpi: Dpi = Field(description="Dots per inch.")
    pictures: Cases = Field(description="Failures of an examination that are drawn.")


class SealedParams(Strict):
    """The whole of pipelines/sealed/params.yaml."""

    conceal: ConcealParams
    examine: ExamineParams
    score: SealedScoreParams


def load_sealed(path: Path, *overrides: Mapping[str, Any]) -> SealedParams:
    """pipelines/sealed/params.yaml with `overrides` merged in; ConfigError names every key that is wrong."""
    return read(path, SealedParams, overrides)
