"""What a picture shows, as far as a test can tell."""

from pathlib import Path

import numpy as np
from PIL import Image


def drawn(path: Path) -> bool:
    """Whether it is a picture of a readable size, with something on its background."""
    with Image.open(path) as picture:
        pixels = np.asarray(picture.convert("RGB")).reshape(-1, 3)
        kinds, counts = np.unique(pixels, axis=0, return_counts=True)
        return min(picture.size) >= 200 and len(kinds) > 2 and counts.max() < 0.99 * len(pixels)
