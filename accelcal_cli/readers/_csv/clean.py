"""Text clean-up of whole blocks, so that pyarrow's parser understands them. Lines stay lines."""

from __future__ import annotations

import re
from dataclasses import dataclass

import numpy as np

from accelcal_cli.readers._csv.dates import year_first

SPLIT_DATE = re.compile(rb"(\d{4}[-/]\d\d[-/]\d\d) (?=\d\d:\d\d)")
COLON_FRACTION = re.compile(rb":(?<=\d:)\d\d:\d\d:\d{1,9}(?!\d|:)")
COLON, POINT = b":."
LONG_FRACTION = re.compile(rb"(:\d\d[.,]\d{9})\d+")
TAB_TO_BLANK = bytes.maketrans(b"\t", b" ")


@dataclass(frozen=True, slots=True)
class Cleaner:
    """What has to be changed in a block of lines before it is parsed.

    Attributes:
        delimiter: between the columns; a blank stands for any run of blanks and tabs.
        padded: blanks around the delimiter are to go.
        split_date: date and time of day are separated by the delimiter itself.
        decimal_comma: decimals are written with a comma.
        slash_dates: dates are written 2024/03/04.
        long_fraction: seconds have more than nine decimals.
        colon_fraction: a colon stands before the decimals of seconds.
        date_order: of day, month and year, such as `dmy`, where dates do not begin with the year.
        thorough: look at every line for what differs from the others.
    """

    delimiter: str
    padded: bool = False
    split_date: bool = False
    decimal_comma: bool = False
    slash_dates: bool = False
    long_fraction: bool = False
    colon_fraction: bool = False
    date_order: str | None = None
    thorough: bool = False

    def __call__(self, block: bytes) -> bytes:
        """The block in pyarrow's terms, with the same lines in the same order."""
        if self.delimiter == " ":
            block = trimmed(collapsed(block.translate(TAB_TO_BLANK)), b"\n")
        elif self.padded or self.thorough:
            block = trimmed(trimmed(collapsed(block), self.delimiter.encode()), b"\n")
        block = self._with_times(block)
        return block.translate(self._table()) if self.decimal_comma or self.slash_dates else block

    def _with_times(self, block: bytes) -> bytes:
        """The block with dates and fractions of seconds as ISO 8601 has them."""
        if self.date_order is not None:
            block = year_first(block, self.date_order, self.thorough)
        if self.split_date:
            block = SPLIT_DATE.sub(rb"\1T", block)
        if self.colon_fraction:
            block = with_points(block)
        if self.long_fraction:
            block = LONG_FRACTION.sub(rb"\1", block)
        return block

    def _table(self) -> bytes:
        pairs = [(b",", b".")] * self.decimal_comma + [(b"/", b"-")] * self.slash_dates
        return bytes.maketrans(b"".join(old for old, _ in pairs), b"".join(new for _, new in pairs))


def collapsed(block: bytes) -> bytes:
    """Runs of blanks as one blank."""
    while b"  " in block:
        block = block.replace(b"  ", b" ")
    return block


def with_points(block: bytes) -> bytes:
    """`12:34:56:789` as `12:34:56.789`."""
    text = np.frombuffer(block, np.uint8).copy()
    colon = text == COLON
    text[6:][colon[6:] & colon[3:-3] & colon[:-6]] = POINT
    return text.tobytes()


def trimmed(block: bytes, mark: bytes) -> bytes:
    """No single blank before or after the mark, or at either end."""
    block = block.replace(b" \r\n", b"\n") if mark == b"\n" else block
    return block.replace(b" " + mark, mark).replace(mark + b" ", mark).strip(b" ")
