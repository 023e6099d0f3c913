"""What is known of a recording before its samples are read: info.txt, and the beginning of log.bin."""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass, field

import numpy as np

from accelcal_cli.core.errors import UnreadableError
from accelcal_cli.core.recording import Problem
from accelcal_cli.readers._gt3x.archive import Archive
from accelcal_cli.readers._gt3x.framing import Batch
from accelcal_cli.readers._gt3x.imu import ACCELEROMETER, Schema, parse_schema
from accelcal_cli.readers._gt3x.info import Info, parse_info
from accelcal_cli.readers._gt3x.layout import SENSOR_DATA, SENSOR_SCHEMA
from accelcal_cli.readers._gt3x.member import MemberStream
from accelcal_cli.readers._gt3x.page import ANY_TIME, Span
from accelcal_cli.readers._gt3x.parameters import START_TIME, Key, in_utc, parameters_in, payloads
from accelcal_cli.readers._gt3x.primary import DOCKED_BYTES, KINDS, samples_in
from accelcal_cli.readers._gt3x.signature import INFO, LOG
from accelcal_cli.readers._gt3x.stream import batches

INFO_BYTES = 1 << 20
DAY_S = 86_400
LONGEST_S = 366 * DAY_S
NO_INFO = "info.txt is missing from the zip file"
BAD_INFO = "info.txt in the zip file is damaged and was not used"


def read_info(archive: Archive) -> tuple[Info, tuple[Problem, ...]]:
    """info.txt, and what is wrong with it; a damaged one is not used at all."""
    member = archive.members.get(INFO)
    if member is None:
        return Info(), (Problem("damaged_header", NO_INFO, None, 0),)
    try:
        with MemberStream(archive, member) as stream:
            data = stream.read(INFO_BYTES)
            damaged = stream.fault is not None
    except UnreadableError:
        damaged = True
    return (Info(), (Problem("damaged_header", BAD_INFO, None, 0),)) if damaged else (parse_info(data), ())


@dataclass(slots=True)
class Beginning:
    """What the first records of log.bin say, up to the first samples.

    Attributes:
        rate: samples that most records of the first piece with any hold; None without any.
        first_s: second of the first samples.
        imu: the device's second sensor recorded too.
    """

    parameters: dict[Key, int] = field(default_factory=dict)
    utc: bool = False
    schema: Schema | None = None
    rate: int | None = None
    first_s: int | None = None
    imu: bool = False

    def take(self, batch: Batch) -> None:
        """Look at the next records."""
        self.parameters = parameters_in(batch) | self.parameters
        self.utc |= in_utc(batch)
        self.imu |= bool((batch.records.kind == SENSOR_DATA).any())
        if self.schema is None:
            schemas = [parse_schema(data) for data in payloads(batch, SENSOR_SCHEMA)]
            usable = [schema for schema in schemas if schema and schema.axes(ACCELEROMETER)]
            self.schema = usable[0] if usable else None
        self._take_samples(batch)

    def _take_samples(self, batch: Batch) -> None:
        records = batch.records
        held = records.select(np.isin(records.kind, KINDS) & (records.size > DOCKED_BYTES))
        rows = samples_in(held)
        if self.rate is None and rows.any():
            self.rate = Counter(rows[rows > 0].tolist()).most_common(1)[0][0]
            self.first_s = int(held.second[rows > 0][0])


def look_inside(archive: Archive, *, imu: bool) -> Beginning:
    """Read log.bin until there are samples, of the second sensor with its schema if that is wanted.

    Raises:
        UnreadableError: the disk fails, or log.bin is packed in an unusual way.
    """
    beginning = Beginning()
    with MemberStream(archive, archive.members[LOG]) as stream:
        for batch in batches(stream, ANY_TIME):
            beginning.take(batch)
            if beginning.imu and beginning.schema if imu else beginning.rate:
                break
    return beginning


def span_of(info: Info, beginning: Beginning) -> Span:
    """Between which times records are expected."""
    start_us = info.start_us
    start_s = beginning.parameters.get(START_TIME) if start_us is None else start_us // 1_000_000
    first_s = beginning.first_s if start_s is None else start_s
    return ANY_TIME if first_s is None else Span(first_s - DAY_S, first_s + LONGEST_S)
