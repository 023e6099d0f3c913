"""Files that are not recordings: epochs and counts of many devices, still windows, other kinds of files.

They are recognised by their content, so that the error says what they are and what to give instead.
"""

from __future__ import annotations

import re
import shlex
from collections.abc import Iterable
from dataclasses import dataclass

from accelcal_cli.core.errors import NoRecordingError, Reason, UnreadableError, printable
from accelcal_cli.core.formats import Probe, is_text

NOT_RAW = "epochs, not raw acceleration"
LOOKED_AT = 4096
HEADER_LINES = 200
INSIST = "; or give --unit and --columns to read it anyway"
FIT = "fit them with `accelcal fit`; or give --columns to read them as samples"

SEPARATORS = re.compile(r"[,;\t|]")
NUMBER = re.compile(r"[+-]?\d+(?:[.,]\d+)?")
"""A cell that no line of names has; a setting above the table may name counts or steps with it."""

AXIS = re.compile(r"(?:.*[^a-z])?[xyz](?:[^a-z].*)?|a(?:cc)?[xyz]")
EPOCH_NAMES = frozenset(
    {
        *("activity", "activity counts", "activiteit", "activit\u00e9", "aktivit\u00e4t", "atividade"),
        *("counts", "vector magnitude", "axis1", "steps", "activityminute", "activityhour", "calories"),
        *("mets", "met", "pim", "zcm", "enmo", "moderate-vigorous", "enmo_t", "anglez"),
    }
)
"""Lower-case names of columns of tables of epochs that have no columns of x, y and z."""

OF_OTHER_TOOLS = re.compile(
    r"(?:.*[_ ])?l?f?enmo(?:trunc)?(?:[_ ].*)?|hf?enplus|b?f?en|mad|nonwearscore|clippingscore|anglez.*|"
    r"sleeponset\w*|spt\w*|dur_\w*|sleepdurationinspt|cleaningcode|acc_\w+_mg|vector\.magnitude|"
    r"clips(?:before|after)calibr|acceleration \(mg\) - .*"
)
"""Lower-case names of columns of tables by GGIR, biobankAccelerometerAnalysis and agcounts."""

NOT_AXES = re.compile(r"(?:.*[^a-z])?(?:angle|gyr|mag|euler|quat|rot|sd|std|range|min|max).*")
"""Names of columns that end in x, y or z and are not acceleration."""

MEAN_COLUMNS = ({"x", "y", "z"}, {"meanx", "meany", "meanz"}, {"mean_x", "mean_y", "mean_z"})
WINDOW_COLUMNS = {"weight", "posture", "counts_per_g", "spread_x", "meanx", "mean_x"}
"""Columns of tables of still windows that are not the means, or names of the means (`collect/table.py`)."""


@dataclass(frozen=True, slots=True)
class NotRecording:
    """The content of a file, following the word "holds", what to do instead, and the reason in a study."""

    what: str
    hint: str
    reason: Reason


def _epochs(device: str, hint: str) -> NotRecording:
    return NotRecording(f"{device} {NOT_RAW}", hint, Reason("epochs", {"whose": device}))


NO_RAW = "no raw acceleration can be exported from it"
SIGNS: tuple[tuple[re.Pattern[bytes], NotRecording], ...] = (
    (re.compile(rb'\s*\[\s*\{\s*"(?:dateTime|logId)"'), _epochs("Fitbit's", NO_RAW)),
    (re.compile(rb"[^<]{0,8}<\?xml[^>]*>\s*<motionfile"), _epochs("a MotionWatch's", NO_RAW)),
    (re.compile(rb"(?s).{0,2000}?Motion(?:Watch|Ware)"), _epochs("a MotionWatch's", NO_RAW)),
    (re.compile(rb"(?s).{0,2000}?Acti(?:ware|watch)"), _epochs("an Actiwatch's", NO_RAW)),
    (
        re.compile(rb"[^\n]*\n\s*\d\d-\w{3}-\d{4}\s*\n\s*\d\d?:\d\d(?::\d\d)?\s*\n\s*\d+\s*\n"),
        _epochs("an Actiwatch's", NO_RAW),
    ),
    (re.compile(rb"\W*Actical List Export"), _epochs("an Actical's", NO_RAW)),
    (re.compile(rb"\W*Condor Instruments Report"), _epochs("an ActTrust's", NO_RAW)),
    (re.compile(rb"(?s).{0,1000}?Store rate:.{0,200}?Binning mode:"), _epochs("a Daqtometer's", NO_RAW)),
)
"""Beginnings of files that are not recordings.

They are taken from the test files of github.com/wadpac/GGIRread and github.com/ghammad/pyActigraphy.
"""

TABLE_OF = "make a table of it: `(echo {names}; jq -r '{select} | @csv' FILE) > FILE.csv`{more}"
"""Hint for JSON; FILE stands for the name of the file."""

UNREAD: tuple[tuple[re.Pattern[bytes], str, str], ...] = (
    (
        re.compile(rb'(?s)\s*\{\s*"items"\s*:\s*\[\s*\{.{0,400}?"timestamp"'),
        "accelerations of ResearchKit, as JSON",
        TABLE_OF.format(
            names="time,x,y,z",
            select=".items[] | [.timestamp, .x, .y, .z]",
            more=", and give --unit g (the times count from when the phone was switched on)",
        ),
    ),
    (
        re.compile(rb'(?s)\s*[{\[].{0,400}?"ArrayAcc"\s*:\s*\['),
        "accelerations of a Movesense, as JSON",
        TABLE_OF.format(
            names="time_ms,x,y,z",
            select=".. | objects | select(.ArrayAcc) | .Timestamp as $t | .ArrayAcc[] | [$t, .x, .y, .z]",
            more=", and give --unit m/s2",
        ),
    ),
)
"""Recordings that are not read: their beginnings, what they hold, and what to do.

They are of ORKDataLogger of ResearchKit, and of the sensors' own form of the Movesense API.
"""

DATX = (
    "an activPAL's recording as the device stores it",
    "export the uncompressed raw acceleration as csv with PALanalysis or PALbatch, and give that",
)
SQLITE = b"SQLite format 3\0"
SAVE_SHEET = "save its sheet as CSV: File, Save As, CSV UTF-8"
SAVE_TABLE = "save the samples as CSV or Parquet, with the program that made it, and give that"
NOT_ONE = "give the recording itself"
UNPACK_FIRST = "unpack it first: "
KINDS: tuple[tuple[bytes, str, str, bool], ...] = (
    (rb"7z\xbc\xaf\x27\x1c", "a 7z archive", f"{UNPACK_FIRST}7z x FILE", True),
    (rb"Rar!\x1a\x07", "a RAR archive", f"{UNPACK_FIRST}unrar x FILE", True),
    (rb"\x04\x22\x4d\x18", "packed with LZ4", f"{UNPACK_FIRST}unlz4 -k FILE", True),
    (
        rb"version https://git-lfs\.github\.com/",
        "a git-lfs pointer, not the file that it stands for",
        "fetch that: `git lfs pull --include FILE`",
        True,
    ),
    (
        rb"\x93NUMPY",
        "a NumPy array (.npy)",
        "make an .npz of it: python3 -c 'import numpy, sys; "
        'numpy.savez("NAME.npz", acc=numpy.load(sys.argv[1]))\' FILE',
        False,
    ),
    (
        rb"(?i)(?:\xef\xbb\xbf)?\s*(?:<!--.{0,200}?-->\s*)?<(?:!doctype\s+html|html|head|body)\b",
        "a web page (HTML)",
        "where it stands for a download that failed, download the recording again",
        False,
    ),
    (
        rb"PK\x03\x04.{26}(?:\[Content_Types\]\.xml|_rels/|docProps/|xl/w|mimetypeapplication/vnd\.)",
        "a workbook or another document of an office program (.xlsx, .ods)",
        SAVE_SHEET,
        False,
    ),
    (
        rb"\xd0\xcf\x11\xe0\xa1\xb1\x1a\xe1",
        "a workbook or another document of an old office program (.xls)",
        SAVE_SHEET,
        False,
    ),
    (rb"\$FL[23]", "a data file of SPSS", SAVE_TABLE, False),
    (rb"<stata_dta>", "a data file of Stata", SAVE_TABLE, False),
    (rb"RD[AX][23]\n|[AX]\n\0\0\0[\2\3]", "a data file of R", SAVE_TABLE, False),
    (rb"%PDF-", "a PDF document", NOT_ONE, False),
    (rb"\xff\xd8\xff|\x89PNG\r\n|GIF8[79]a|II\*\0|MM\0\*", "a picture", NOT_ONE, False),
    (rb".{4}ftyp|\x1a\x45\xdf\xa3", "a video or a sound", NOT_ONE, False),
)
"""Kinds of files by their beginnings: what each is, what to do, and whether it stands for a recording.

One that does fails in a study; FILE stands for the name of the file. Sources: the signatures in the formats'
own documents.
"""

OWN_JSON = re.compile(rb'(?s)\s*\{(?:\s*"kind"\s*:\s*"(\w{1,20})".{0,80}?|.{0,400}?)"accelcal_version"\s*:')
OWN_TABLE = re.compile(rb"(?:\w{1,40},)*accelcal_version(?:,|\s)")
"""Beginnings of outputs of accelcal, of any version (`core/identity.py`)."""
AGD = _epochs("ActiGraph's", "give the .gt3x file of the same recording, from the device or from ActiLife")
DATABASE = NotRecording("an SQLite database", "export the recording as text (CSV)", Reason("database"))
TABLE = _epochs("a table of", "export the raw data" + INSIST)
WINDOWS = NotRecording("means of still windows, not samples", FIT, Reason("still_windows"))


def refuse_not_recordings(probe: Probe) -> None:
    """Raise NoRecordingError for a file known to be no recording, unless the user says how to read it.

    Raises UnreadableError for a recording that has to be exported first.
    """
    options = probe.options
    start, unread = probe.head[:LOOKED_AT], DATX if probe.suffix == ".datx" else None
    if is_text(start):
        unread = next(((what, hint) for sign, what, hint in UNREAD if sign.match(start)), None)
    if unread is not None:
        what, hint = unread
        name = shlex.quote(printable(probe.path))
        raise UnreadableError(f"holds {what}", path=probe.path, hint=hint.replace("FILE", name))
    if (kind := known_kind(start)) is not None:
        what, hint, stands_for_one = kind
        hint = hint.replace("FILE", shlex.quote(printable(probe.path)))
        if stands_for_one:
            raise UnreadableError(f"is {what}", path=probe.path, hint=hint)
        raise NoRecordingError(
            f"is {what}", path=probe.path, hint=hint, reason=Reason.of("other_kind", what=what)
        )
    found = _recognised(probe)
    if found is not None and options.columns is None and options.unit is None:
        raise NoRecordingError(f"holds {found.what}", path=probe.path, hint=found.hint, reason=found.reason)


def known_kind(head: bytes) -> tuple[str, str, bool] | None:
    """Return what a file is by its first bytes, what to do, and whether it stands for a recording."""
    if (own := OWN_JSON.match(head)) is not None or OWN_TABLE.match(head) is not None:
        name = own[1].decode() if own is not None and own[1] else "table" if own is None else "document"
        return f"an output of accelcal ({name})", "give the recording that it was made of", False
    return next((found[1:] for found in KINDS if re.match(found[0], head, re.DOTALL)), None)


def _recognised(probe: Probe) -> NotRecording | None:
    """Return what a file is by its beginning, or by the names of columns; None for any other.

    A table with columns of x, y and z may be raw whatever its beginning says.
    """
    head = probe.head
    if head.startswith(SQLITE):
        return AGD if probe.suffix == ".agd" or b"epochlength" in head or b"inclineOff" in head else DATABASE
    if b"\0" in head[:LOOKED_AT]:
        return None
    signed = next((other for sign, other in SIGNS if sign.match(head[:LOOKED_AT])), None)
    lines = [[cell.strip(' "\ufeff#;%') for cell in SEPARATORS.split(line)] for line in first_lines(head)]
    named = [by_names(cells) for cells in lines if not any(map(NUMBER.fullmatch, cells))]
    tables = [one.table for one in named if one is not None]
    if all(table is TABLE for table in tables):
        return signed or next(iter(tables), None)
    return next(table for table in tables if table is not TABLE)


def first_lines(head: bytes) -> list[str]:
    """Return the first lines of a text, in lower case."""
    return head[: 4 * LOOKED_AT].decode("utf-8", "replace").lower().splitlines()[:HEADER_LINES]


def names_axes(head: bytes) -> bool:
    """Return True if a line of a text names three columns as axes are named, in two words at most each."""
    for line in first_lines(head):
        cells = {re.sub(r"\s*[\[(].*", "", cell.strip(' "\ufeff#')) for cell in SEPARATORS.split(line)}
        axes = {cell for cell in cells if AXIS.fullmatch(cell) and not NOT_AXES.fullmatch(cell)}
        if len(axes) >= len("xyz") and all(len(cell.split()) <= 2 for cell in axes):
            return True
    return False


@dataclass(frozen=True, slots=True)
class NamedTable:
    """The names of columns show this: a table that is not a recording, or None for one that may be raw."""

    table: NotRecording | None


def by_names(columns: Iterable[str]) -> NamedTable | None:
    """Return what the names of columns in lower case show of a table; None if they show nothing."""
    names = set(columns)
    plain = {re.sub(r"\s*[\[(].*", "", name) for name in names}
    if any(means <= plain for means in MEAN_COLUMNS) and WINDOW_COLUMNS & plain:
        return NamedTable(WINDOWS)
    axes = [name for name in plain if AXIS.fullmatch(name) and not NOT_AXES.fullmatch(name)]
    if len(axes) >= len("xyz"):
        return NamedTable(None)
    known = EPOCH_NAMES & names or any(map(OF_OTHER_TOOLS.fullmatch, plain | names))
    return NamedTable(TABLE) if len(names) > 1 and known and not axes else None


def epochs_by_names(columns: Iterable[str]) -> NotRecording | None:
    """Return what a table is by the names of its columns, if it is not a recording; None for any other."""
    found = by_names(name.lower() for name in columns)
    return None if found is None else found.table
