"""All hypotheses: every effect of the catalogue, at every site where it can act and at groups of sites."""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from simgap.diagnosis.hypotheses.support import ALWAYS, Since, Support
from simgap.diagnosis.likelihood.problem import Group
from simgap.effects.augmented import Augmented, Slot
from simgap.effects.effect import Constant, Effect, Scales, Site


class Hypothesis(NamedTuple):
    """One effect at one site, or shared by several, that acts in a support.

    groups: its free constants, each with the number of the support's gate. starts: internal constants [k] from which
    searches start. twin: the same constants acting everywhere; they are free as well if two sets of recordings are
    compared.
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
    """All hypotheses of one effect that acts throughout, or (`events`) of one that acts in a window only."""
    return [
        _hypothesis(augmented, scales, e, where, members)
        for e, (effect, sites) in enumerate(zip(augmented.catalogue, augmented.sites, strict=True))
        if effect.event == events
        for where, members in _site_groups(effect, sites)
        if all(effect.starts(scales, s) for s in members)
    ]


def changed(hypothesis: Hypothesis, baseline: int) -> Hypothesis:
    """The hypothesis that an effect differs after the first `baseline` sessions, with gate 1."""
    return behind(hypothesis, Since(baseline), 1)._replace(twin=hypothesis.groups)


def behind(hypothesis: Hypothesis, support: Support, gate: int) -> Hypothesis:
    """The same hypothesis, acting only in a support, with the number of its gate (from 1)."""
    groups = tuple(g._replace(support=gate) for g in hypothesis.groups)
    return hypothesis._replace(support=support, groups=groups)


def within_session(
    throughout: Sequence[Hypothesis], events: Sequence[Hypothesis], to_its_end: bool
) -> tuple[list[Hypothesis], list[Hypothesis]]:
    """Both lists for a window of one session, with each law in one of them only: a law of both is a push (an event),
    or a drift if the window lasts to the session's end."""
    named, others = (throughout, events) if to_its_end else (events, throughout)
    laws = [c.effect.law for c in named]
    others = [c for c in others if c.effect.law not in laws]
    return (list(named), others) if to_its_end else (others, list(named))


def _hypothesis(augmented: Augmented, scales: Scales, e: int, where: str, members: tuple[int, ...]) -> Hypothesis:
    effect, sites = augmented.catalogue[e], augmented.sites[e]
    entries = [tuple(augmented.index[Slot(e, k, s)] for s in members) for k in range(len(effect.constants))]
    low, high = augmented.bounds
    starts = []
    # A shared constant starts at the value of the site with the greatest range.
    widest = min if effect.constants[0].reciprocal else max
    lead = widest(members, key=lambda s: abs(effect.starts(scales, s)[0][0]))
    for start in effect.starts(scales, lead):
        limits = [(low[of[0]], high[of[0]]) for of in entries]
        starts.append(tuple(float(np.clip(c, *limit)) for c, limit in zip(start, limits, strict=True)))
    # A constant's scale is its smallest nonzero size among the starts.
    sizes = [min(abs(c) for c in of if c) for of in zip(*starts, strict=True)]
    groups = tuple(Group(of, size) for of, size in zip(entries, sizes, strict=True))
    return Hypothesis(
        effect, members, where, _union(sites[s].channels for s in members), _union(sites[s].outputs for s in members),
        groups, tuple(starts),
    )  # fmt: skip


def unit_of(augmented: Augmented, hypothesis: Hypothesis, constant: Constant) -> str:
    """The unit of a hypothesis's constant at its site."""
    site = augmented.sites[augmented.catalogue.index(hypothesis.effect)][hypothesis.sites[0]]
    return constant.unit.replace("{u}", site.unit).replace("{x}", site.length)


def _site_groups(effect: Effect, sites: tuple[Site, ...]) -> list[tuple[str, tuple[int, ...]]]:
    """Names and members of single sites and of groups (family, branch, all) that may share constants."""
    groups: dict[tuple[int, ...], str] = {(s,): site.name for s, site in enumerate(sites)}
    if effect.tie != "never":
        sets: dict[str, list[int]] = {}
        for s, site in enumerate(sites):
            branch = [f"{site.family} {site.branch}"] if site.branch else []
            for name in (site.family, *branch, *(["all"] if effect.tie == "any" else [])):
                sets.setdefault(name, []).append(s)
        for name, members in sets.items():
            units = dict.fromkeys(sites[s].unit for s in members)
            same_unit = [tuple(s for s in members if sites[s].unit == u) for u in units]
            for part in [tuple(members)] if effect.tie == "any" else same_unit:
                label = name if len(part) == len(members) else ", ".join(sites[s].name for s in part)
                groups.setdefault(part, label)
    return [(where, members) for members, where in groups.items() if members]


def _union(lists) -> tuple[str, ...]:
    return tuple(dict.fromkeys(name for names in lists for name in names))
