"""Which datasets of an HDF5 file can be read as rows of one or three numbers."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np


@dataclass(frozen=True, slots=True)
class Track:
    """A dataset of `rows` rows of `width` numbers; the rows run along its axis `axis`."""

    path: str
    rows: int
    width: int
    axis: int
    dtype: np.dtype[Any]

    @property
    def name(self) -> str:
        """The last part of the path."""
        return self.path.rsplit("/", 1)[-1]

    @property
    def parent(self) -> str:
        """The group that holds it, `/` for the file itself."""
        return self.path.rsplit("/", 1)[0] or "/"


def as_track(path: str, dataset: Any) -> Track | None:
    """How a dataset can be read as rows of 1 or 3 numbers; None where it cannot.

    (n,), (n, 1) and (1, n) are rows of one, (n, 3) and (3, n) rows of three; (3, 3) and (1, 3)
    are read with the rows along the first axis.
    """
    shape = dataset.shape
    if shape is None or len(shape) not in (1, 2) or dataset.dtype.kind not in "iuf":
        return None
    if len(shape) == 1:
        return Track(path, shape[0], 1, 0, dataset.dtype)
    for axis in (0, 1):
        if shape[1 - axis] in (1, 3):
            return Track(path, shape[axis], shape[1 - axis], axis, dataset.dtype)
    return None
