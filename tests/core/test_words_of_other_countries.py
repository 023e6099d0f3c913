"""Names of months and temperatures in further languages, and text in UTF-16 that does not say so."""

from __future__ import annotations

import pytest

from accelcal_cli.core.formats import as_utf8, utf16_in
from accelcal_cli.core.thermometers import find_thermometer
from accelcal_cli.core.written_times import written_start

TEXT = "time,x,y,z\n2024-03-04T10:00:00.000,0.1,-0.2,0.97\n" * 8


@pytest.mark.parametrize("name", ["utf-16-le", "utf-16-be"])
def test_t2_text_in_utf_16_without_its_mark_is_read(name: str) -> None:
    assert utf16_in(TEXT.encode(name)) == name
    assert as_utf8(TEXT.encode(name)) == TEXT.encode()
    assert as_utf8(TEXT.encode("utf-16")).decode().lstrip("\ufeff") == TEXT


def test_bytes_that_are_no_text_stay_as_they_are() -> None:
    for head in (TEXT.encode(), bytes(range(256)), b"\x00" * 64, b"\x01\x00\x02\x00" * 32, b"ab"):
        assert utf16_in(head) is None and as_utf8(head) == head


@pytest.mark.parametrize(
    "text",
    ["4 marca 2024 10:41:40", "4 Mrz 2024 10:41:40", "2024年03月04日 10:41:40", "2024-03-04 10-41-40"],
)
def test_t6_times_of_further_languages_and_shapes(text: str) -> None:
    assert written_start(text) == written_start("2024-03-04 10:41:40") is not None


@pytest.mark.parametrize("name", ["température", "Temperatura [°C]", "t_celsius", "温度", "température_°C"])
def test_t9_temperatures_are_known_in_further_languages(name: str) -> None:
    found, _ = find_thermometer([("x", None), (name.lower(), None)])
    assert found is not None
