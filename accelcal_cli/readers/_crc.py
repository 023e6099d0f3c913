"""Checksums of many equally long pages at once."""

from __future__ import annotations

import zlib
from functools import cache

import numpy as np
from numpy.typing import NDArray

CRC16_POLYNOMIAL = 0x1021
CRC16_START = 0xFFFF


def crc32_pages(pages: NDArray[np.uint8], start: int, stop: int) -> NDArray[np.uint32]:
    """CRC-32 (IEEE 802.3, as in zlib) of bytes start..stop-1 of each page.

    Args:
        pages: (p, page_bytes), rows contiguous.

    Returns:
        (p,) checksums.
    """
    if not len(pages):
        return np.empty(0, np.uint32)
    view = np.ascontiguousarray(pages).data.cast("B")
    size = pages.shape[1]
    return np.array(
        [zlib.crc32(view[at + start : at + stop]) for at in range(0, len(view), size)], dtype=np.uint32
    )


def crc16_pages(pages: NDArray[np.uint8], start: int, stop: int) -> NDArray[np.uint16]:
    """CRC-16/CCITT-FALSE (polynomial 0x1021, start 0xFFFF, not reflected) of each page's bytes.

    A CRC is linear over GF(2): that of a page is the XOR of what each byte alone contributes, so
    one table row per position lets all pages go through together.

    Args:
        pages: (p, page_bytes).

    Returns:
        (p,) checksums.
    """
    table, start_part = crc16_positions(stop - start)
    total = np.full(len(pages), start_part, np.uint16)
    columns = np.ascontiguousarray(pages[:, start:stop].T)
    for row, column in zip(table, columns, strict=True):
        total ^= row[column]
    return total


@cache
def crc16_positions(length: int) -> tuple[NDArray[np.uint16], int]:
    """What byte value v at position i of `length` adds: table[i, v]; and what the start value adds."""
    one = crc16_table()
    table = np.empty((length, 256), np.uint16)
    here = one
    for position in range(length - 1, -1, -1):
        table[position] = here
        here = shift_byte(here)
    state = np.array([CRC16_START], np.uint16)
    for _ in range(length):
        state = shift_byte(state)
    return table, int(state[0])


def shift_byte(state: NDArray[np.uint16]) -> NDArray[np.uint16]:
    """The checksum states after one more zero byte."""
    return np.asarray((state << np.uint16(8)) ^ crc16_table()[state >> np.uint16(8)])


@cache
def crc16_table() -> NDArray[np.uint16]:
    """The checksum of each byte value alone, from state 0."""
    state = np.arange(256, dtype=np.uint32) << 8
    for _ in range(8):
        state = (state << 1) ^ np.where(state & 0x8000, CRC16_POLYNOMIAL, 0).astype(np.uint32)
    table: NDArray[np.uint16] = (state & 0xFFFF).astype(np.uint16)
    return table
