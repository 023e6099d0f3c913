"""The uncompressed bytes of one part of the zip file, as a stream that survives damage."""

from __future__ import annotations

import zlib
from enum import Enum
from types import TracebackType
from typing import Any, Self

from accelcal_cli.core.errors import UnreadableError
from accelcal_cli.readers._gt3x.archive import DEFLATED, ENCRYPTED, STORED, Archive, Member

STEP_BYTES = 1 << 14
MOST_BYTES = 1 << 19
"""Of uncompressed bytes at once: damaged or empty stretches unpack to a thousand times their size."""

UNKNOWN_SIZE = 1 << 62


class Fault(Enum):
    """Why a part is not as it was packed."""

    CUT_OFF = "the file is cut short"
    DAMAGED = "it is damaged within"
    WRONG_CHECKSUM = "its checksum does not fit"


class MemberStream:
    """Reads a part from its beginning.

    The file is taken in equal steps, so that what is salvaged from a damaged one does not depend
    on how much is asked for at a time.

    Attributes:
        size: uncompressed bytes so far.
        fault: known after the last byte.
    """

    def __init__(self, archive: Archive, member: Member) -> None:
        """Open a part.

        Raises:
            UnreadableError: it is encrypted or compressed in an unusual way, or cannot be opened.
        """
        self.member = member
        self.size = 0
        self.fault: Fault | None = None
        self._path, self._ends = archive.path, archive.ends
        self._refuse_unknown()
        self._left = UNKNOWN_SIZE if member.packed_bytes is None else member.packed_bytes
        self._inflate: Any = zlib.decompressobj(-zlib.MAX_WBITS) if member.method == DEFLATED else None
        self._ended = self._more = False
        self._crc = 0
        self._ahead = b""
        try:
            self._file = archive.path.open("rb")
            self._file.seek(min(member.start_byte, archive.size))
        except OSError as error:
            raise self._unreadable(error) from error

    def read(self, count: int) -> bytes:
        """`count` bytes, fewer only at the end.

        Raises:
            UnreadableError: the disk fails.
        """
        parts, have = [self._ahead], len(self._ahead)
        while have < count and not self._ended:
            parts.append(self._step())
            have += len(parts[-1])
        data = b"".join(parts)
        self._ahead = data[count:]
        return data[:count]

    @property
    def disk_position(self) -> int:
        """How far the file on the disk has been read."""
        return self._file.tell()

    def close(self) -> None:
        """Release the file."""
        self._file.close()

    def _step(self) -> bytes:
        fresh = not self._more
        packed = self._taken() if fresh else self._inflate.unconsumed_tail
        data = packed if self._inflate is None else self._inflated(packed)
        self._more = self._inflate is not None and len(data) == MOST_BYTES
        self._crc = zlib.crc32(data, self._crc)
        self.size += len(data)
        if self.fault or self._complete() or (fresh and not packed):
            self._end()
        return data

    def _taken(self) -> bytes:
        try:
            packed = self._file.read(min(STEP_BYTES, self._left))
        except OSError as error:
            raise self._unreadable(error) from error
        self._left -= len(packed)
        return packed

    def _inflated(self, packed: bytes) -> bytes:
        before = self._inflate.copy()
        try:
            return bytes(self._inflate.decompress(packed, MOST_BYTES))
        except zlib.error:
            self.fault = Fault.DAMAGED
            return salvaged(before, packed)

    def _complete(self) -> bool:
        return self._left == 0 if self._inflate is None else bool(self._inflate.eof)

    def _end(self) -> None:
        self._ended = True
        if self.fault is None and not self._complete():
            self.fault = Fault.DAMAGED if self._ends else Fault.CUT_OFF
        elif self.fault is None and self.member.unpacked_bytes not in (None, self.size):
            self.fault = Fault.DAMAGED
        elif self.fault is None and self.member.crc not in (None, self._crc):
            self.fault = Fault.WRONG_CHECKSUM

    def _refuse_unknown(self) -> None:
        if self.member.method not in (STORED, DEFLATED):
            encrypted = self.member.method == ENCRYPTED
            how = "is encrypted" if encrypted else f"is compressed in an unusual way ({self.member.method})"
            raise UnreadableError(
                f"{self.member.name} in it {how}",
                path=self._path,
                hint="unpack it and pack it again as a plain zip file",
            )

    def _unreadable(self, error: OSError) -> UnreadableError:
        return UnreadableError(f"cannot be read ({error.strerror or error})", path=self._path)

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        self.close()


def salvaged(inflate: Any, packed: bytes) -> bytes:
    """What a decompressor still gives of bytes that are damaged somewhere."""
    parts: list[bytes] = []
    try:
        for at in range(len(packed)):
            parts.append(inflate.decompress(packed[at : at + 1]))
    except zlib.error:
        pass
    return b"".join(parts)
