"""The contract of a format: one frozen record that each file in `readers/` binds as FORMAT."""

from __future__ import annotations

import gzip
import zlib
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

from accelcal_cli.core.errors import UnreadableError, UsageError
from accelcal_cli.core.recording import Reader

HEAD_BYTES = 65_536
GZIP_MAGIC = b"\x1f\x8b"
RATE_AGREEMENT = 0.05


@dataclass(frozen=True, slots=True)
class ReadOptions:
    """What the user said about a recording; None means: find out.

    Attributes:
        unit: one of g, mg, m/s2, counts.
        columns: names (or numbers from 0) of x, y and z.
        date_format: order of day, month and year in dates: dmy, mdy or ymd.
        layout: a layout file for raw dumps.
        sensor: which sensor of a file with several.
    """

    format: str | None = None
    rate_hz: float | None = None
    unit: str | None = None
    lsb_per_g: float | None = None
    columns: tuple[str, str, str] | None = None
    time_column: str | None = None
    date_format: str | None = None
    timezone: str | None = None
    layout: Path | None = None
    sensor: str | None = None


def agreed_rate(options: ReadOptions, told_hz: float, path: Path) -> float:
    """The rate that a recording tells of itself, or the user's where it is about the same.

    Raises:
        UsageError: the two contradict each other; the file's own times would become gaps.
    """
    if options.rate_hz is None:
        return told_hz
    if abs(options.rate_hz - told_hz) > RATE_AGREEMENT * told_hz:
        raise UsageError(
            f"the recording was made at {told_hz:g} Hz, not {options.rate_hz:g}",
            path=path,
            hint="leave --rate out: this format says its rate itself",
        )
    return options.rate_hz


@dataclass(frozen=True, slots=True)
class Probe:
    """What a sniffer may look at: never the whole file.

    Attributes:
        path: the recording.
        head: its first 64 KiB, uncompressed where the file is gzip.
        size: bytes on disk.
        compressed: whether the file is gzip.
        options: what the user said.
    """

    path: Path
    head: bytes
    size: int
    compressed: bool
    options: ReadOptions

    @property
    def suffix(self) -> str:
        """Lower-case suffix without a trailing .gz, such as `.cwa`."""
        name = self.path.name.lower().removesuffix(".gz")
        return Path(name).suffix


@dataclass(frozen=True, slots=True)
class Format:
    """One recording format.

    Attributes:
        name: as in `--format` and in the report.
        title: for people, one line.
        suffixes: usual lower-case suffixes, with the dot; only a hint.
        sniff: confidence 0..100 that the probed file is of this format. 0: certainly not;
            100: a magic number or signature matches. Never raises.
        ignores: reading options that mean nothing to it, such as `columns`.
        open: opens it. Raises UnreadableError with a place and a hint, UsageError where an
            option is needed.
    """

    name: str
    title: str
    suffixes: tuple[str, ...]
    sniff: Callable[[Probe], int]
    open: Callable[[Path, ReadOptions], Reader]
    ignores: tuple[str, ...] = ()


def probe_file(path: Path, options: ReadOptions) -> Probe:
    """Look at the beginning of a file.

    Raises:
        UnreadableError: it is missing, empty, not a file, or its gzip header is damaged.
    """
    try:
        size = path.stat().st_size
        if path.is_dir():
            raise UnreadableError("is a folder, not a recording", path=path, hint="name the files in it")
        if size == 0:
            raise UnreadableError("is empty", path=path, byte_offset=0, hint="copy it again from the device")
        with path.open("rb") as file:
            head = file.read(HEAD_BYTES)
        compressed = head.startswith(GZIP_MAGIC)
        if compressed:
            head = gzip_head(path)
    except OSError as error:
        raise UnreadableError(
            f"cannot be read ({error.strerror or error})", path=path, hint="check the path and permissions"
        ) from error
    return Probe(path, head, size, compressed, options)


def gzip_head(path: Path) -> bytes:
    """The first uncompressed bytes of a gzip file, as many as a truncated one still gives.

    Raises:
        UnreadableError: nothing can be decompressed.
    """
    parts: list[bytes] = []
    try:
        with gzip.open(path, "rb") as file:
            while sum(map(len, parts)) < HEAD_BYTES and (part := file.read1(HEAD_BYTES)):
                parts.append(part)
    except (EOFError, zlib.error, gzip.BadGzipFile) as error:
        if not parts:
            raise UnreadableError(
                f"damaged gzip data ({error})", path=path, byte_offset=0, hint="copy it again from its source"
            ) from error
    return b"".join(parts)[:HEAD_BYTES]
