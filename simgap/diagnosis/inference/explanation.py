"""The best explanation of the recordings: fits, effects, noise, what is left, and when each acts."""

from typing import NamedTuple

import numpy as np

from simgap.diagnosis.config import EXPLAINED, LIKELY
from simgap.diagnosis.hypotheses.support import ALWAYS, Support
from simgap.diagnosis.inference.alternatives import Member
from simgap.diagnosis.inference.model import Round, without
from simgap.diagnosis.inference.noise_effect import NoiseEffect
from simgap.diagnosis.inference.nonparametric import Law
from simgap.diagnosis.inference.posterior import Spread, differs_from_zero
from simgap.diagnosis.inference.whiteness import Whiteness, named_share
from simgap.diagnosis.likelihood.problem import Fit, Problem
from simgap.diagnosis.likelihood.segments import Chunks
from simgap.effects.regime import EVERYWHERE, Acting, Regime, everywhere


class Explanation(NamedTuple):
    """The best explanation of the recordings.

    nominal, base, fit: the simulator as it is (as the baseline left it), refitted, and with the effects, fitted alike.
    sd: of its constants. members: the effects; scattered: those on the scatter; left: what they leave over; law: one
    beside them that has no name. unseen: the held-out rows, with the effects' supports. supports: when and where
    effects act that do not act throughout. rounds: what was tried. baseline: number of its sessions; with any, what is
    left over is what they do not leave as well, and no law without a name is looked for.
    """

    problem: Problem
    nominal: Fit
    base: Fit
    fit: Fit
    sd: Spread
    members: tuple[Member, ...]
    noise_effects: list[NoiseEffect]
    whiteness: Whiteness
    law: Law
    unseen: Chunks
    supports: tuple[Support, ...]
    rounds: list[Round]
    baseline: int

    def names(self, member: Member) -> bool:
        """Whether an effect explains its outputs, rather than being the nearest word for something else.

        A constant that does not differ from zero, though its effect gains, stands for what the parameters do; what many
        names fit alike is likely something that has none; and so is what a law explains only where it bends.
        """
        if member.odds[member.hypothesis.effect.id] < LIKELY:
            return False
        if member.gain < EXPLAINED * (member.gain + member.misfit):
            return False
        nameless = np.maximum(self.whiteness.nats, self.law.nats(self.fit))
        share = named_share(self.problem.augmented.layout, self.fit, member.without, nameless)
        return share >= EXPLAINED and differs_from_zero(self.problem, self.fit, member.hypothesis, self.sd)

    @property
    def anything(self) -> bool:
        """Whether an effect was found, or something without a name."""
        return bool(self.members or self.whiteness.nats.any() or self.law.terms)

    @property
    def ids(self) -> set[str]:
        """Of the effects found."""
        return {m.hypothesis.effect.id for m in self.members}

    @property
    def regimes(self) -> tuple[Regime, ...]:
        """Of every support; everywhere, where there is none, or it is a matter of time."""
        return tuple(s if isinstance(s, Regime) else EVERYWHERE for s in self.supports) or (EVERYWHERE,)

    @property
    def known_supports(self) -> tuple[Support, ...]:
        """Those that are known before a forecast; in which regime it is, a forecast says itself."""
        return tuple(ALWAYS if isinstance(s, Regime) else s for s in self.supports)

    def acting(self, fit: Fit) -> Acting:
        """The constants of a fit, as part of a simulator: what changed since a baseline acts in it as well, and what
        acts in a regime acts there; what acts for a while only is no part of it."""
        theta, delta = np.asarray(fit.v.theta), np.asarray(fit.v.delta)
        if self.baseline and not self.supports:
            return everywhere(theta + delta[0])
        lasting = [s for s, support in enumerate(self.supports) if isinstance(support, Regime)]
        return Acting(theta, delta[lasting], tuple(self.regimes[s] for s in lasting))

    def known(self) -> Fit:
        """The fit without the effects that are nearest words only; nothing is fitted anew."""
        return without(self.fit, [group for m in self.members if not self.names(m) for group in m.hypothesis.groups])
