"""mHealth tables, in which NHANES publishes its raw data: an hour a file, described by the file's name.

The name is `MODEL-DATA-VERSION.SERIAL.YYYY-MM-DD-hh-mm-ss-mmm-ZONE.sensor.csv`, with `x` for the points of
the version (mhealth-specification, github.com/mhealthgroup; NHANES 2011-2014, documentation of PAX80_G). The
zone is P0000 throughout in NHANES, whose times are local: it is not believed. ActiGraphs repeat their last
sample while they sleep (`formats/_rows.py`); a GT3X+ measures +-6 g.
"""

from __future__ import annotations

import re
from dataclasses import replace

from accelcal_cli.core.recording import Device
from accelcal_cli.core.unpacking import plain_name
from accelcal_cli.formats.tables.vendors import Head, Stated, Vendor

HEAD = re.compile(r"HEADER_TIME_?STAMPS?", re.IGNORECASE)
NAME = re.compile(
    r"([^.-]+)-[^.-]+(?:-([\dx]+))?\.([^.]+)\.\d{4}(?:-\d\d){5}-\d{3}-[PM]\d{4}\.sensor\.csv",
    re.IGNORECASE,
)
ACTIGRAPH = re.compile(r"GT3X|wGT3X|ActiGraph", re.IGNORECASE)
RANGE_G = {"GT3XPLUS": 6.0}


def recognise(head: Head) -> bool:
    """Return True if a column has this name."""
    return any(map(HEAD.fullmatch, head.names))


def describe(_head: Head) -> Stated:
    """Return that values are in g, all that the head itself says."""
    return Stated(title="mHealth", unit="g")


def from_name(name: str, export: Stated) -> Stated:
    """Return the description with what the name of a file adds."""
    found = NAME.fullmatch(plain_name(name))
    if found is None:
        return export
    model, version, serial = found.groups()
    return replace(
        export,
        device=Device(model, serial, None if version is None else version.replace("x", ".")),
        range_g=RANGE_G.get(model.upper()),
        repeats_idle=ACTIGRAPH.search(model) is not None,
    )


VENDOR = Vendor("mhealth", recognise, describe, from_name, by_names=True)
