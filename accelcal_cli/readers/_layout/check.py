"""Whether the sizes and offsets of a layout can be true together."""

from __future__ import annotations

from itertools import pairwise
from pathlib import Path

from accelcal_cli.core.errors import UsageError
from accelcal_cli.readers._layout.model import CHECKSUM_BYTES, SEQUENCE_TYPES, TIME_TYPES, Layout

LARGEST_FRAME = 1 << 16
LARGEST_PAGE = 1 << 24

Span = tuple[int, int, str]


def check_geometry(layout: Layout, path: Path, *, paged: bool) -> None:
    """Refuse sizes that contradict each other.

    Args:
        paged: whether the layout gives page_bytes.

    Raises:
        UsageError: names the key, the file and what is wrong.
    """
    try:
        check_frame(layout)
        if paged:
            check_page(layout)
        else:
            check_stream(layout)
    except ImpossibleError as error:
        raise UsageError(f"layout: {error}", path=path) from None


class ImpossibleError(Exception):
    """Which key cannot be true, and why."""


def check_frame(layout: Layout) -> None:
    """Fields lie within the frame, side by side."""
    if layout.frame_bytes > LARGEST_FRAME:
        raise ImpossibleError(f"dump.frame_bytes is {layout.frame_bytes}, more than {LARGEST_FRAME}")
    spans = [(field.offset, field.end, f"fields.{name}") for name, field in layout.fields.items()]
    for _, end, name in spans:
        if end > layout.frame_bytes:
            raise ImpossibleError(f"{name} ends at byte {end}, but dump.frame_bytes is {layout.frame_bytes}")
    check_apart(spans)


def check_stream(layout: Layout) -> None:
    """Without pages nothing may be said of pages."""
    if layout.page_header_bytes or layout.page_trailer_bytes:
        raise ImpossibleError("dump.page_bytes is missing, but a page header or trailer is given")
    if layout.sequence or layout.stamp or layout.checksum:
        raise ImpossibleError("dump.page_bytes is missing, but [page] is given")


def check_page(layout: Layout) -> None:
    """A page holds its header, at least one frame and its trailer, and its keys lie outside the frames."""
    outside = layout.page_header_bytes + layout.page_trailer_bytes
    if layout.page_bytes > LARGEST_PAGE:
        raise ImpossibleError(f"dump.page_bytes is {layout.page_bytes}, more than {LARGEST_PAGE}")
    if outside + layout.frame_bytes > layout.page_bytes:
        raise ImpossibleError(
            f"dump.page_bytes is {layout.page_bytes}, but header, trailer and one frame take "
            f"{outside + layout.frame_bytes} bytes"
        )
    spans = page_spans(layout)
    for _, end, name in spans:
        if end > layout.page_bytes:
            raise ImpossibleError(f"{name} ends at byte {end}, but dump.page_bytes is {layout.page_bytes}")
    frames = (layout.page_header_bytes, layout.page_header_bytes + layout.page_frames * layout.frame_bytes)
    check_apart([*spans, (*frames, "the frames (dump.page_header_bytes and dump.page_trailer_bytes)")])
    check_covers(layout)


def page_spans(layout: Layout) -> list[Span]:
    """First byte, byte after the last, and name of each key of [page]."""
    spans = []
    if layout.sequence:
        at = layout.sequence.offset
        spans.append((at, at + SEQUENCE_TYPES[layout.sequence.type], "page.sequence"))
    if layout.stamp:
        spans.append((layout.stamp.offset, layout.stamp.offset + TIME_TYPES[layout.stamp.type], "page.time"))
    if layout.checksum:
        at = layout.checksum.offset
        spans.append((at, at + CHECKSUM_BYTES[layout.checksum.type], "page.crc"))
    return spans


def check_covers(layout: Layout) -> None:
    """The checksum covers bytes of the page, not itself."""
    crc = layout.checksum
    if crc is None:
        return
    if crc.stop > layout.page_bytes:
        raise ImpossibleError(
            f"page.crc.covers ends at {crc.stop}, but dump.page_bytes is {layout.page_bytes}"
        )
    if crc.start < crc.offset + CHECKSUM_BYTES[crc.type] and crc.offset < crc.stop:
        raise ImpossibleError("page.crc.covers includes the checksum itself")


def check_apart(spans: list[Span]) -> None:
    """No two spans share a byte."""
    for (_, end, name), (start, _, other) in pairwise(sorted(spans)):
        if start < end:
            raise ImpossibleError(f"{name} and {other} overlap at byte {start}")
