"""What may be missing: every effect of the catalogue, at every site where it can act and at sites that share it."""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from simgap.diagnosis.hypotheses.support import ALWAYS, Since, Support
from simgap.diagnosis.likelihood.problem import Group
from simgap.effects.augmented import Augmented, Slot
from simgap.effects.effect import Constant, Effect, Scales, Site


class Hypothesis(NamedTuple):
    """One effect at one site, or shared by several, that acts in a support.

    groups: its free constants, each with the number of the support's gate; starts: internal constants [k] each that a
    search starts at. twin: the same constants acting everywhere, free as well where the question is what changed
    between two sets of recordings.
    """

    effect: Effect
    sites: tuple[int, ...]
    where: str
    channels: tuple[str, ...]
    outputs: tuple[str, ...]
    groups: tuple[Group, ...]
    starts: tuple[tuple[float, ...], ...]
    support: Support = ALWAYS
    twin: tuple[Group, ...] = ()

    @property
    def name(self) -> str:
        return f"{self.effect.key} on {self.where}"


def hypotheses_of(augmented: Augmented, scales: Scales, events: bool = False) -> list[Hypothesis]:
    """All hypotheses of one effect that acts throughout, or of those that act during a stretch only."""
    return [
        _hypothesis(augmented, scales, e, where, members)
        for e, (effect, sites) in enumerate(zip(augmented.catalogue, augmented.sites, strict=True))
        if effect.event == events
        for where, members in _tied(effect, sites)
    ]


def changed(hypothesis: Hypothesis, baseline: int) -> Hypothesis:
    """The hypothesis that an effect differs since a baseline of so many sessions, whose gate is the first."""
    return behind(hypothesis, Since(baseline), 1)._replace(twin=hypothesis.groups)


def behind(hypothesis: Hypothesis, support: Support, gate: int) -> Hypothesis:
    """The same hypothesis, acting in a support only, whose gate has this number (from 1)."""
    groups = tuple(g._replace(support=gate) for g in hypothesis.groups)
    return hypothesis._replace(support=support, groups=groups)


def within_session(
    throughout: Sequence[Hypothesis], events: Sequence[Hypothesis], to_its_end: bool
) -> tuple[list[Hypothesis], list[Hypothesis]]:
    """Of both, those that may act during a stretch of one session, each law by one name: a drift is a push there,
    unless it lasts to the session's end."""
    named, others = (throughout, events) if to_its_end else (events, throughout)
    laws = [c.effect.law for c in named]
    others = [c for c in others if c.effect.law not in laws]
    return (list(named), others) if to_its_end else (others, list(named))


def _hypothesis(augmented: Augmented, scales: Scales, e: int, where: str, members: tuple[int, ...]) -> Hypothesis:
    effect, sites = augmented.catalogue[e], augmented.sites[e]
    entries = [tuple(augmented.index[Slot(e, k, s)] for s in members) for k in range(len(effect.constants))]
    low, high = augmented.bounds
    starts = []
    # Sites that share a constant are searched at the start of the one with the greatest range.
    widest = min if effect.constants[0].reciprocal else max
    lead = widest(members, key=lambda s: abs(effect.starts(scales, s)[0][0]))
    for start in effect.starts(scales, lead):
        limits = [(low[of[0]], high[of[0]]) for of in entries]
        starts.append(tuple(float(np.clip(c, *limit)) for c, limit in zip(start, limits, strict=True)))
    # The smallest size that a constant is looked for at is its scale.
    sizes = [min(abs(c) for c in of if c) for of in zip(*starts, strict=True)]
    groups = tuple(Group(of, size) for of, size in zip(entries, sizes, strict=True))
    return Hypothesis(
        effect, members, where, _union(sites[s].channels for s in members), _union(sites[s].outputs for s in members),
        groups, tuple(starts),
    )  # fmt: skip


def unit_of(augmented: Augmented, hypothesis: Hypothesis, constant: Constant) -> str:
    """The unit of a hypothesis's constant where it acts."""
    site = augmented.sites[augmented.catalogue.index(hypothesis.effect)][hypothesis.sites[0]]
    return constant.unit.replace("{u}", site.unit)


def _tied(effect: Effect, sites: tuple[Site, ...]) -> list[tuple[str, tuple[int, ...]]]:
    """Single sites, sites of one family or branch of it, and all sites; they share a constant only with its unit."""
    found: dict[tuple[int, ...], str] = {(s,): site.name for s, site in enumerate(sites)}
    if effect.tie != "never":
        sets: dict[str, list[int]] = {}
        for s, site in enumerate(sites):
            branch = [f"{site.family} {site.branch}"] if site.branch else []
            for name in (site.family, *branch, *(["all"] if effect.tie == "any" else [])):
                sets.setdefault(name, []).append(s)
        for name, members in sets.items():
            units = dict.fromkeys(sites[s].unit for s in members)
            alike = [tuple(s for s in members if sites[s].unit == u) for u in units]
            for part in [tuple(members)] if effect.tie == "any" else alike:
                label = name if len(part) == len(members) else ", ".join(sites[s].name for s in part)
                found.setdefault(part, label)
    return [(where, members) for members, where in found.items() if members]


def _union(lists) -> tuple[str, ...]:
    return tuple(dict.fromkeys(name for names in lists for name in names))
