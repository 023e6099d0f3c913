"""Calibration of raw accelerometer recordings from the stillness that they contain.

    import accelcal

    result = accelcal.calibrate("recording.cwa")   # or an array: accelcal.calibrate(xyz, rate=100)
    result.to_pandas()                             # calibrated values
    result.calibration(xyz)                        # the coefficients, on other values

`read`, `inspect`, `calibrate`, `apply`, `fit`, `from_poses`, `effect`, `study`, `export`, `report` and
`simulate` do the work of the commands of these names, with the same bits (docs/python.md). Their options are
those of the commands, as keywords: `--lsb-per-g` is `lsb_per_g`.
"""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING

from accelcal_cli.core.version import __version__ as __version__

if TYPE_CHECKING:
    from accelcal._api import Reading as Reading
    from accelcal._api import Samples as Samples
    from accelcal._api import apply as apply
    from accelcal._api import calibrate as calibrate
    from accelcal._api import effect as effect
    from accelcal._api import fit as fit
    from accelcal._api import from_poses as from_poses
    from accelcal._api import inspect as inspect
    from accelcal._api import read as read
    from accelcal._options import CalibrationOptions as CalibrationOptions
    from accelcal._options import FitOptions as FitOptions
    from accelcal._options import PoseOptions as PoseOptions
    from accelcal._options import ReadingOptions as ReadingOptions
    from accelcal._options import StudyOptions as StudyOptions
    from accelcal._results import Calibration as Calibration
    from accelcal._results import Report as Report
    from accelcal._results import Result as Result
    from accelcal._studies import export as export
    from accelcal._studies import report as report
    from accelcal._studies import simulate as simulate
    from accelcal._studies import study as study
    from accelcal_cli.core.errors import AccelcalError as AccelcalError
    from accelcal_cli.core.reasons import Reason as Reason
    from accelcal_cli.output.words import sentence as sentence

_HOMES = {
    "accelcal._api": (
        *("Reading", "Samples", "apply", "calibrate", "effect", "fit", "from_poses", "inspect", "read"),
    ),
    "accelcal._options": (
        *("CalibrationOptions", "FitOptions", "PoseOptions", "ReadingOptions", "StudyOptions"),
    ),
    "accelcal._results": ("Calibration", "Report", "Result"),
    "accelcal._studies": ("export", "report", "simulate", "study"),
    "accelcal_cli.core.errors": ("AccelcalError",),
    "accelcal_cli.core.reasons": ("Reason",),
    "accelcal_cli.output.words": ("sentence",),
}
"""Names by the module that has them, imported when one is first used."""

__all__ = [
    "AccelcalError", "Calibration", "CalibrationOptions", "FitOptions", "PoseOptions", "Reading",
    "ReadingOptions", "Reason", "Report", "Result", "Samples", "StudyOptions", "apply", "calibrate", "effect",
    "export", "fit", "from_poses", "inspect", "read", "report", "sentence", "simulate", "study",
]  # fmt: skip

if not TYPE_CHECKING:  # a name that is not there is an error for type checkers, too

    def __getattr__(name):
        for home, names in _HOMES.items():
            if name in names:
                return globals().setdefault(name, getattr(import_module(home), name))
        from accelcal._hints import no_such_name

        raise no_such_name(name, __all__)


def __dir__() -> list[str]:
    return sorted([*__all__, "__version__"])
