"""Where an effect acts, in terms of motion: the axes that its site moves, and the quantities of a law there."""

from collections.abc import Collection, Sequence
from typing import NamedTuple

import numpy as np

from simgap.diagnosis.hypotheses.library import Quantity
from simgap.effects.effect import Bend, Site
from simgap.layout import YAW, Layout


class Place(NamedTuple):
    """A site's own motion: (body, axis) pairs, and its command channels."""

    moving: tuple[tuple[int, int], ...]
    channels: tuple[str, ...]

    def axes(self, layout: Layout) -> list[str]:
        """Names of the axes along which the site can be pushed."""
        return [layout.outputs(b, (a,))[0] for b, a in self.moving if layout.velocity[b, a] >= 0]

    def quantities(self, layout: Layout, known: Sequence[Quantity], bends: Collection[Bend]) -> list[int]:
        """Indices in `known` (of `library.quantities`) of the site's own quantities of these kinds."""
        indices = [i for i, q in enumerate(known) if "command" in bends and q.name in self.channels]
        for b, a in self.moving:
            indices += [4 * b + a] if "speed" in bends else []
            indices += [4 * len(layout.bodies) + 3 * b + a] if "place" in bends and a != YAW else []
        return indices


def place_of(layout: Layout, site: Site) -> Place:
    """Motion that a site's channels drive; if they drive none, that of the state with its name, or of its outputs."""
    commands, states = [f.name for f in layout.schema.command], [f.name for f in layout.schema.state]
    tables = [(layout.driven, commands.index(name)) for name in site.channels]
    if not any((table == index).any() for table, index in tables):
        shown = [site.name] if site.name in states else site.outputs
        tables = [(t, states.index(name)) for name in shown for t in (layout.velocity, layout.position)]
    moving = [tuple(map(int, where)) for table, index in tables for where in np.argwhere(table == index)]
    return Place(tuple(dict.fromkeys(moving)), site.channels)  # type: ignore[arg-type]  # pairs
