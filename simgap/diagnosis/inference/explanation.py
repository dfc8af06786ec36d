"""The best explanation of the recordings: fits, effects with their supports, noise effects, whiteness."""

from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from simgap.diagnosis.hypotheses.support import ALWAYS, Support
from simgap.diagnosis.inference.evidence.screening import Screened
from simgap.diagnosis.inference.fitting.model import Round
from simgap.diagnosis.inference.misfit.nonparametric import Law
from simgap.diagnosis.inference.misfit.whiteness import Whiteness, named_share
from simgap.diagnosis.inference.noise.effect import NoiseEffect
from simgap.diagnosis.inference.search.alternatives import Member
from simgap.diagnosis.inference.search.posterior import Spread
from simgap.diagnosis.likelihood.problem import Fit, Problem
from simgap.diagnosis.likelihood.segments import Chunks
from simgap.effects.regime import EVERYWHERE, Acting, Regime, everywhere
from simgap.engines import Term


class Hidden(NamedTuple):
    """A hidden state behind a joint that explains the recordings better than what was found there.

    term: what it is and where. value, ci95: of its constant, in the term's unit. odds: probability of each id. gain:
    over the model without what it replaces [nats]. heldout_gain: over what was found, on held-out rows [nats]. named:
    whether it is named. replaces: names of the effects that stand in for it. phi, phi_sd: parameters fitted with it,
    and their standard deviations.
    """

    term: Term
    value: float
    ci95: tuple[float, float]
    odds: dict[str, float]
    gain: float
    heldout_gain: float
    named: bool
    replaces: tuple[str, ...]
    phi: Float[np.ndarray, " p"]
    phi_sd: Float[np.ndarray, " p"]


class Explanation(NamedTuple):
    """The best explanation of the recordings.

    nominal: the simulator as it is; with a baseline, with the effects that the baseline shows. base: refitted without
    effects. fit: refitted with the effects; sd: standard deviations of its constants. members: the effects.
    noise_effects: effects on the noise. whiteness: how far the residuals can be predicted. law: a nonparametric law
    apart from the effects. unseen: held-out rows with the gates of the supports. supports: of effects that do not act
    throughout. rounds: the hypotheses tried. baseline: number of its sessions. With any, `whiteness` is what exceeds
    theirs, and no nonparametric law is searched for. unsettled: ids of effects that the search before did not find,
    although it was the last one. hidden: states behind joints that the simulator has no word for. elsewhere: the
    hypothesis that held-out sessions support most, if they show what the fitted ones do not.
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
    unsettled: frozenset[str] = frozenset()
    hidden: tuple[Hidden, ...] = ()
    elsewhere: Screened | None = None

    def stands_in(self, member: Member) -> bool:
        """Whether an effect only stands in for a hidden state that is named."""
        return any(h.named and member.hypothesis.name in h.replaces for h in self.hidden)

    def named_share(self, member: Member) -> float:
        """Share that an effect explains of what there is to explain in the outputs that it improves."""
        nameless = np.maximum(self.whiteness.nats, self.law.nats(self.fit))
        return named_share(self.problem.augmented.layout, self.fit, member.without, nameless)

    @property
    def parameters(self) -> tuple[Float[np.ndarray, " p"], Float[np.ndarray, " p"]]:
        """The fitted parameters and their standard deviations: those with a named hidden state, if there is one."""
        for h in self.hidden:
            if h.named:
                return h.phi, h.phi_sd
        return np.asarray(self.fit.v.phi, float), self.sd.phi

    @property
    def anything(self) -> bool:
        """Whether an effect, predictable residuals or a nonparametric law was found."""
        return bool(self.members or self.whiteness.nats.any() or self.law.terms)

    @property
    def ids(self) -> set[str]:
        """Ids of the effects found."""
        return {m.hypothesis.effect.id for m in self.members}

    @property
    def regimes(self) -> tuple[Regime, ...]:
        """The regime of every support: everywhere if the support is one in time, or if there are no supports."""
        return tuple(s if isinstance(s, Regime) else EVERYWHERE for s in self.supports) or (EVERYWHERE,)

    @property
    def known_supports(self) -> tuple[Support, ...]:
        """Supports that are known before a forecast. A regime counts as always: the forecast itself decides it."""
        return tuple(ALWAYS if isinstance(s, Regime) else s for s in self.supports)

    def acting(self, fit: Fit) -> Acting:
        """The constants of a fit, as part of a simulator.

        Changes since a baseline always act, effects in a regime act there, effects limited in time are left out.
        """
        theta, delta = np.asarray(fit.v.theta), np.asarray(fit.v.delta)
        if self.baseline and not self.supports:
            return everywhere(theta + delta[0])
        lasting = [s for s, support in enumerate(self.supports) if isinstance(support, Regime)]
        return Acting(theta, delta[lasting], tuple(self.regimes[s] for s in lasting))
