"""What Python says is typed in Python: functions and keywords in place of commands and options."""

from __future__ import annotations

import re
from collections.abc import Callable
from typing import Any

import numpy as np
import pandas as pd
import pytest

import accelcal
from accelcal._calling import worded
from tests.output.test_words import CASES
from tests.test_python_memory import FRAME, XYZ


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("accelcal calibrate a.csv -R time_format='%d/%m %H'; or -R time_column=none and --rate",
         "accelcal.calibrate('a.csv', time_format='%d/%m %H'); or time_column='none' and rate"),
        ("say: accelcal calibrate array -R time_format=ms", "say: accelcal.calibrate(..., time_format='ms')"),
        ("use accelcal study 'my folder' -d OUT --sensor each, or name one with --sensor",
         "use accelcal.study('my folder', 'OUT', sensor='each'), or name one with sensor"),
        ("(accelcal apply, or accelcal study --borrow), or the device (accelcal six-pose).",
         "(accelcal.apply, or accelcal.study(borrow=True)), or the device (accelcal.from_poses)."),
        ("fitted with `accelcal fit`", "fitted with accelcal.fit"),
        ("again: accelcal calibrate RECORDING", "again: accelcal.calibrate(RECORDING)"),
        ("accelcal devices OUT --registry F.json makes", "accelcal.devices(OUT, registry='F.json') makes"),
        ("accelcal watch FOLDER --rate 25", None),
        ("a folder with -d, a name with -o, or use --force", "a folder, or use force=True"),
        ("--sensor a or --sensor 1.5", "sensor='a' or sensor='1.5'"),
        ("Check --model 6, --rate 25 and --parts: so", "Check model='6', rate=25 and parts=True: so"),
        ("-R max_damage=70. Use --unit m/s2. Try --format csv.",
         "max_damage=70. Use unit='m/s2'. Try format='csv'."),
        ("give --unit and --columns, or --columns X,Y,Z", "give unit and columns, or columns='X,Y,Z'"),
        ("data (--to ggir -d DIR), --any-device", "data (to='ggir', folder=DIR), any_device=True"),
        ("to `accelcal study` with -d, or --timezone UTC", "to accelcal.study, or timezone='UTC'"),
        ("`git lfs pull --include FILE`, without --sparse; accelcal report out/*.json", None),
        ("accelcal study F --unlock, study --settle S; --shard 1/8 --unlock", None),
        ("roll it (six-pose --roll)", "roll it (accelcal.from_poses(roll=...))"),
        ("another folder with -d, or a name with -o", "another folder"),
    ],
)  # fmt: skip
def test_commands_become_calls(text: str, said: str | None) -> None:
    assert worded(text, "array") == (said or text)


TYPED = r"(^|[ (])-(-[a-z]|[RdoA-Z] )|accelcal [a-z-]+ "
"""What is typed at a terminal."""


@pytest.mark.parametrize(("code", "values"), CASES)
def test_no_sentence_has_an_option_of_the_command(code: str, values: dict[str, Any]) -> None:
    assert not re.search(TYPED, accelcal.sentence(accelcal.Reason(code, values)))


def text_of(page: str) -> str:
    return re.sub(r"<(style|script)\b.*?</\1>|<[^<>]*>", " ", page, flags=re.DOTALL)


CALLS: dict[str, Callable[[], Any]] = {
    "rate": lambda: accelcal.calibrate(XYZ),
    "unit": lambda: accelcal.calibrate((100_000 * XYZ).astype(int), rate=25),
    "times": lambda: accelcal.calibrate({"time": ["a", "b"] * 100, "accel": XYZ[:200]}),
    "sensors": lambda: accelcal.calibrate(FRAME.assign(sensor=["a", "b"] * (len(FRAME) // 2))),
    "points": lambda: accelcal.fit(XYZ),
    "refused": lambda: accelcal.calibrate(XYZ[:500], rate=25).message,
    "advice": lambda: " ".join(map(accelcal.sentence, accelcal.calibrate(XYZ[:500], rate=25).advice)),
    "notebook": lambda: text_of(accelcal.calibrate(7 * XYZ, rate=25, unit="g")._repr_html_()),
    "notebook, refused": lambda: text_of(accelcal.calibrate(XYZ[:500], rate=25)._repr_html_()),
    "shown": lambda: repr(accelcal.calibrate(7 * XYZ, rate=25, unit="g")),
}


@pytest.mark.parametrize("name", CALLS)
def test_advice_is_in_the_words_of_python(name: str) -> None:
    try:
        said = CALLS[name]()
    except accelcal.AccelcalError as error:
        said = str(error)
    assert isinstance(said, str) and said
    assert not re.search(TYPED, said)


@pytest.mark.parametrize("hours", [0, 6, 12])
def test_a_summary_has_the_hours_of_wear(hours: int) -> None:
    """A device that lies still for hours was not worn then."""
    random = np.random.default_rng(1)
    off = random.normal(0, 1e-4, (hours * 3600 * 25, 3)) + np.array([0.0, 0.0, 1.0])
    moves = (np.arange(len(XYZ)) % 500 < 250)[:, np.newaxis]
    moving = np.tile(XYZ + random.normal(0, 0.02, XYZ.shape) * moves, (4, 1))
    worn = accelcal.calibrate(np.concatenate([moving, off]), rate=25, unit="g")
    table = pd.DataFrame([worn.summary()])
    assert table["wear_hours"][0] == pytest.approx(2.0, abs=0.6)
