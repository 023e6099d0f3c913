"""Names of months and temperatures in further languages, and text in UTF-16 and UTF-32."""

from __future__ import annotations

import pytest

from accelcal_cli.core.formats import as_utf8, wide_text
from accelcal_cli.core.vocabulary import find_thermometer
from accelcal_cli.core.written_times import written_start

TEXT = "time,x,y,z\n2024-03-04T10:00:00.000,0.1,-0.2,0.97\n" * 8


RAW = b"\x00\x00\xfe\xff" + bytes(range(1, 200))


@pytest.mark.parametrize("name", ["utf-16-le", "utf-16-be", "utf-32-le", "utf-32-be"])
def test_t2_text_in_utf_16_and_utf_32_is_read_with_its_mark_or_without(name: str) -> None:
    assert wide_text(TEXT.encode(name)) == name
    assert as_utf8(TEXT.encode(name)) == TEXT.encode()
    marked = f"\ufeff{TEXT}".encode(name)
    assert wide_text(marked) == name[:6]
    assert as_utf8(marked).decode().lstrip("\ufeff") == TEXT


def test_bytes_that_are_no_text_stay_as_they_are() -> None:
    for head in (TEXT.encode(), bytes(range(256)), b"\x00" * 64, b"\x01\x00\x02\x00" * 32, b"ab", RAW):
        assert wide_text(head) is None and as_utf8(head) == head


@pytest.mark.parametrize(
    "text", ["4 marca 2024 10:41:40", "4 Mrz 2024 10:41:40", "2024年03月04日 10:41:40", "2024-03-04 10-41-40"]
)
def test_t6_times_of_further_languages_and_shapes(text: str) -> None:
    assert written_start(text) == written_start("2024-03-04 10:41:40") is not None


@pytest.mark.parametrize("name", ["température", "Temperatura [°C]", "t_celsius", "温度", "température_°C"])
def test_t9_temperatures_are_known_in_further_languages(name: str) -> None:
    found, _ = find_thermometer([("x", None), (name.lower(), None)])
    assert found is not None
