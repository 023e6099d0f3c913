"""Thrift's compact protocol in `parquet/pages.py`: what is written is read, no cut of it without end."""

from __future__ import annotations

import pytest

from accelcal_cli.parquet import pages

BYTES = bytes([
    0x15, 0x54,  # field 1, i32: zigzag 42
    0x18, 0x02, 0x68, 0x69,  # field 2, binary of 2: "hi"
    0x19, 0x25, 0x01, 0x03,  # field 3, list of two i32: -1, -2
    0x1C, 0x16, 0x80, 0x01, 0x00,  # field 4, struct: field 1, i64: 64
    0x00,
])  # fmt: skip
"""By hand, after thrift-compact-protocol.md."""

FIELDS: pages.Struct = [
    (1, pages.I32, 42),
    (2, pages.BINARY, b"hi"),
    (3, pages.LIST, (pages.I32, [-1, -2])),
    (4, pages.STRUCT, [(1, pages.I64, 64)]),
]


def test_a_structure_by_hand() -> None:
    assert pages.read(BYTES) == FIELDS
    assert pages.written(FIELDS) == BYTES


@pytest.mark.parametrize("length", range(len(BYTES)))
def test_a_structure_that_is_cut_short_is_none(length: int) -> None:
    with pytest.raises(IndexError):
        pages.read(BYTES[:length])


def test_a_whole_number_has_64_bits() -> None:
    assert pages.read(b"\x16" + b"\xff" * 9 + b"\x01\x00") == [(1, pages.I64, -(1 << 63))]
    with pytest.raises(ValueError):
        pages.read(b"\x16" + b"\xff" * 1000 + b"\x01\x00")


def test_a_list_that_claims_more_than_there_is_ends() -> None:
    with pytest.raises(IndexError):
        pages.read(bytes([0x19, 0xF7, 0xFF, 0xFF, 0xFF, 0xFF, 0xFF, 0xFF, 0xFF, 0x7F]))
