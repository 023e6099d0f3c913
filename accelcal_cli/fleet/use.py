"""Which recordings tell something of their device's coefficients."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Iterable
from dataclasses import dataclass
from enum import StrEnum

import numpy as np
from numpy.typing import NDArray

from accelcal_cli.core.judgement import Outcome
from accelcal_cli.fleet.parameters import SCALES
from accelcal_cli.fleet.records import Records


class Use(StrEnum):
    """What became of a recording."""

    USED = "used"
    UNDATED = "undated"
    """Its coefficients count, but not for the drift: no start, or none that can be."""
    COPY = "copy"
    """The same file as another recording of the device."""
    REFUSED = "refused"
    BORROWED = "borrowed"
    GOOD = "already good"
    """Nothing was fitted, since nothing improves on the raw data."""
    SHARED = "shared"
    """The very coefficients of another recording: they were found once."""
    NO_ERRORS = "no errors"
    """Its coefficients have no standard errors."""
    OTHER_MODEL = "other model"
    """Its offsets hold its scale errors, too, and most other recordings' do not, or the reverse."""


COUNTED = (Use.USED, Use.UNDATED)
NOT_OWN: dict[str, Use] = {
    Outcome.REFUSED: Use.REFUSED,
    Outcome.BORROWED: Use.BORROWED,
    Outcome.ALREADY_GOOD: Use.GOOD,
}

OWN = (Use.USED, Use.UNDATED, Use.OTHER_MODEL, Use.NO_ERRORS, Use.GOOD)
"""Recordings whose held-out error is that of their own calibration."""


@dataclass(frozen=True, slots=True)
class _Seen:
    """What decides, by row, looked up once.

    Attributes:
        file: the recording's hash; its row where it has none.
        values: its parameters as bytes.
        fitted, scaled: whether any parameter was, and whether all scales were.
        weighed: whether there are standard errors.
    """

    records: Records
    file: list[str]
    values: list[bytes]
    fitted: list[bool]
    scaled: list[bool]
    weighed: list[bool]
    dated: list[bool]


def uses(records: Records) -> list[Use]:
    """The use of each recording."""
    known = np.isfinite(records.values)
    seen = _Seen(
        records,
        [name or str(row) for row, name in enumerate(records.text["sha256"])],
        [row.tobytes() for row in records.values],
        _each(known, any),
        _each(known[:, SCALES], all),
        _each(np.isfinite(records.errors), any),
        np.isfinite(records.days).tolist(),
    )
    return [use for device in range(len(records.devices)) for use in _of_device(seen, records.rows(device))]


def _each(known: NDArray[np.bool_], whether: Callable[[Iterable[bool]], bool]) -> list[bool]:
    return [whether(row) for row in known.tolist()]


def _of_device(seen: _Seen, rows: range) -> list[Use]:
    pairs = {(seen.values[row], seen.file[row]) for row in rows}
    sharing = Counter(values for values, _ in pairs)
    files: set[str] = set()
    found = []
    for row in rows:
        copy = seen.file[row] in files
        files.add(seen.file[row])
        found.append(Use.COPY if copy else _single(seen, row, shared=sharing[seen.values[row]] > 1))
    return _of_one_family(seen, rows, found)


def _of_one_family(seen: _Seen, rows: range, found: list[Use]) -> list[Use]:
    """Those that fitted the scale, or those that did not: the more; if as many, the former."""
    scaled = [seen.scaled[row] for row, use in zip(rows, found, strict=True) if use in COUNTED]
    usual = 2 * sum(scaled) >= len(scaled)
    return [
        Use.OTHER_MODEL if use in COUNTED and seen.scaled[row] is not usual else use
        for row, use in zip(rows, found, strict=True)
    ]


def _single(seen: _Seen, row: int, *, shared: bool) -> Use:
    own = NOT_OWN.get(seen.records.text["outcome"][row] or "")
    if own is not None:
        return own
    if not seen.fitted[row]:
        return Use.REFUSED if seen.records.text["model"][row] is None else Use.GOOD
    if shared:
        return Use.SHARED
    if not seen.weighed[row]:
        return Use.NO_ERRORS
    return Use.USED if seen.dated[row] else Use.UNDATED


def mask(found: list[Use], *wanted: Use) -> NDArray[np.bool_]:
    """(n,) which recordings have one of these uses."""
    return np.array([use in wanted for use in found], bool)
