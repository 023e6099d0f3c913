"""The contract of a vendor's export: one frozen record that each file of this folder binds as VENDOR.

A vendor's file tells whether a table is its export, and describes what its head says. Some vendors are known
by the lines above their table, which only text has; others by the names of their columns, in any file.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cache, cached_property
from typing import Any

from accelcal_cli.core.formats import HEAD_BYTES, is_text
from accelcal_cli.core.plugins import find_plugins
from accelcal_cli.formats.tables.cells import BYTE_ORDER_MARK, decode
from accelcal_cli.formats.tables.header import Doubt, Start, Stated

__all__ = ["Doubt", "Head", "Lines", "Start", "Stated", "Vendor"]

HEAD_LINES = 200
Lines = tuple[str, ...]
"""The first lines of a text without their ends, at most HEAD_LINES; the last may be cut."""


@dataclass(frozen=True)
class Head:
    """The beginning of a table.

    Attributes:
        names: of the columns, in any order.
        cells: returns the first cells of a column by its number.
        lines: of a text file, up to the names.
    """

    names: tuple[str, ...]
    cells: Callable[[int], list[str]]
    lines: Lines = ()

    @cached_property
    def plain(self) -> tuple[str, ...]:
        """The names in lower case, without units in brackets and blanks around them."""
        return tuple(name.partition("(")[0].partition("[")[0].strip(' "').lower() for name in self.names)

    def numbers(self, *names: str) -> tuple[int, ...] | None:
        """Return the numbers of columns by their names in lower case; None if one is not there just once."""
        if any(self.plain.count(name) != 1 for name in names):
            return None
        return tuple(map(self.plain.index, names))


@dataclass(frozen=True, slots=True)
class Vendor:
    """One vendor's way to write tables.

    Attributes:
        name: of the file that binds it.
        recognise: tells whether `Lines` of a text are this vendor's, or the `Head` of a table. Never raises.
        describe: returns what these say. Never raises: what is damaged is left out.
        from_name: adds to this what the name of the file says. Never raises.
        by_names: it is known by the names of its columns in a head, else by the lines of a text.
    """

    name: str
    recognise: Callable[[Any], bool]
    describe: Callable[[Any], Stated]
    from_name: Callable[[str, Stated], Stated] = lambda _name, stated: stated
    by_names: bool = False


@cache
def all_vendors() -> tuple[Vendor, ...]:
    """Return every vendor, by name."""
    return tuple(find_plugins(__name__, __path__, "VENDOR"))


def export_description(head: bytes) -> Stated | None:
    """Return what the first lines of a vendor's export say; None if it is not known by them, or no text."""
    if not is_text(head[:HEAD_BYTES]):
        return None
    raw = head[:HEAD_BYTES].removeprefix(BYTE_ORDER_MARK).splitlines()[:HEAD_LINES]
    lines = tuple(map(decode, raw))
    return _description(lines, "", by_names=False) if lines else None


def names_description(head: Head, name: str = "") -> Stated | None:
    """Return what the names of columns say, and that of the file; None if no vendor is known by them."""
    return _description(head, name, by_names=True)


def _description(head: Head | Lines, name: str, *, by_names: bool) -> Stated | None:
    known = (vendor for vendor in all_vendors() if vendor.by_names == by_names)
    vendor = next((one for one in known if one.recognise(head)), None)
    return None if vendor is None else vendor.from_name(name, vendor.describe(head))
