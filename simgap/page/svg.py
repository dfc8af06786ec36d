"""The style of the pages' figures, and figures as SVG."""

import io
from typing import Any

from matplotlib.figure import Figure

from simgap.page.marks import FONTS, GREY, INK

STYLE: dict[Any, Any] = {
    "font.family": "DejaVu Sans",
    "font.size": 8.5,
    "text.parse_math": False,  # names with dollars are names
    "text.color": INK,
    "axes.edgecolor": "#b9bec6",
    "axes.labelcolor": GREY,
    "axes.linewidth": 0.8,
    "axes.spines.top": False,
    "axes.spines.right": False,
    "axes.titlesize": 9,
    "axes.titlelocation": "left",
    "axes.titlepad": 4,
    "axes.axisbelow": True,
    "grid.color": "#e8eaee",
    "grid.linewidth": 0.8,
    "xtick.color": "#b9bec6",
    "ytick.color": "#b9bec6",
    "xtick.labelcolor": GREY,
    "ytick.labelcolor": GREY,
    "svg.fonttype": "none",
    "svg.hashsalt": "simgap",
}
"""For `matplotlib.rc_context`."""


def svg(figure: Figure) -> bytes:
    """The figure as an SVG document without a background; equal content makes equal bytes."""
    buffer = io.BytesIO()
    metadata = dict.fromkeys(("Creator", "Date", "Format", "Type"))
    figure.savefig(buffer, format="svg", dpi=200, transparent=True, metadata=metadata)
    # Text stays text, in the page's fonts. DejaVu, which comes with matplotlib, only serves to measure it.
    return buffer.getvalue().replace(b"'DejaVu Sans'", FONTS.encode())
