"""Autocalibration of raw accelerometer recordings, from the periods without movement in them.

For example::

    import accelcal

    result = accelcal.calibrate("recording.cwa")   # or an array: accelcal.calibrate(xyz, rate=100)
    result.to_pandas()                             # calibrated values, as a data frame
    result.calibration(xyz)                        # applies the coefficients to other raw values

`read`, `inspect`, `calibrate`, `apply`, `fit`, `from_poses`, `effect`, `study`, `devices`, `export`,
`report`, `verify` and `simulate` do the same as the commands of these names, with identical results. Options
of the commands are keywords: `--lsb-per-g` is `lsb_per_g`.
"""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING

from accelcal_cli.core.version import __version__ as __version__

if TYPE_CHECKING:
    from accelcal._api import Reading, Samples, apply, calibrate, effect, fit, from_poses, inspect, read
    from accelcal._calling import sentence
    from accelcal._options import CalibrationOptions, FitOptions, PoseOptions, ReadingOptions, StudyOptions
    from accelcal._results import Calibration, Report, Result
    from accelcal._studies import devices, export, report, simulate, study, verify
    from accelcal_cli.core.errors import AccelcalError, Reason

_HOMES = {
    "accelcal._calling": "sentence",
    "accelcal._api": "Reading Samples apply calibrate effect fit from_poses inspect read",
    "accelcal._options": "CalibrationOptions FitOptions PoseOptions ReadingOptions StudyOptions",
    "accelcal._results": "Calibration Report Result",
    "accelcal._studies": "devices export report simulate study verify",
    "accelcal_cli.core.errors": "AccelcalError Reason",
}
"""Names by the module that has them, imported when one is first used."""

__all__ = [
    "AccelcalError", "Calibration", "CalibrationOptions", "FitOptions", "PoseOptions", "Reading",
    "ReadingOptions", "Reason", "Report", "Result", "Samples", "StudyOptions", "apply", "calibrate",
    "devices", "effect", "export", "fit", "from_poses", "inspect", "read", "report", "sentence", "simulate",
    "study", "verify",
]  # fmt: skip

if not TYPE_CHECKING:  # a name that is not there is an error for type checkers, too

    def __getattr__(name):
        for home, names in _HOMES.items():
            if name in names.split():
                return globals().setdefault(name, getattr(import_module(home), name))
        from accelcal._calling import no_such_attribute

        raise no_such_attribute("module 'accelcal'", name, __all__)


def __dir__() -> list[str]:
    return sorted([*__all__, "__version__"])
