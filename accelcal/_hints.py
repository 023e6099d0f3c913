"""What to type instead of a name that other packages have and this one does not."""

from __future__ import annotations

import re

from accelcal_cli.core.errors import did_you_mean

NAME, REPORT = '"recording.cwa"', '"recording.calibration.json"'
CALIBRATE = f"accelcal.calibrate({NAME})"
HINTS = {
    r"read_parquet": 'pandas.read_parquet("recording.calibrated.parquet"): it is an ordinary table',
    r"(read|load|open|scan)_(study|table)": 'pandas.read_parquet("OUT/study.parquet")',
    r"(read|load|open)_(report|calibration|coefficients|json)|load": f"accelcal.Calibration({REPORT})",
    r"(read|open|load|scan)_?\w*|Read\w*": f"accelcal.read({NAME}), which knows all formats",
    r"(to|write|save)_(csv|ggir|biobank|bids|npz|mhealth|omconvert)": f"accelcal.export({REPORT}, to=...)",
    r"(write|save|dump)\w*": f"{CALIBRATE}.write(FOLDER)",
    r"calibrate_gravity|calibrate_accelerometer|g_calibrate|\w*processing": f"{CALIBRATE}.to_pandas()",
    r"transform|predict|apply_\w+": f"accelcal.apply({CALIBRATE}, xyz, temperature)",
    r"(process|run|pipeline|main|cli|process_\w+)": f"{CALIBRATE}, or accelcal.study(FOLDER, OUT) for all",
    r"(fit_transform|auto_?calibrate|autocalibration|get_calib\w*|calibration)": CALIBRATE,
    r"(\w*Calibrat(or|e|ion)\w*)": f"{CALIBRATE}.calibration",
    r"(batch|calibrate_(all|folder|many|files|study)|map)": "accelcal.study(FOLDER, OUT)",
    r"(plot|show|hist)\w*": f"{CALIBRATE}.plot()",
    r"(info|describe|summary|header|head|predict_outcome)": 'accelcal.inspect("recording.cwa")',
    r"(enmo|ENMO|mad|metrics?|activity)": 'accelcal.effect("recording.cwa", epoch=60)',
    r"(?i:ggir\w*|biobank\w*|omconvert|actipy|skdh)": "accelcal.export(RESULTS, to=..., folder=DIR)",
    r"(?i:version)": "accelcal.__version__",
    r"(options|set_option|config)": "help(accelcal.calibrate), which lists them",
    r"(exceptions?|errors?|Error|\w+Error)": "accelcal.AccelcalError",
}
"""For patterns of names of the module: what to type."""

OF_OBJECTS = {
    r"(data|df|frame|dataframe|table|to_df|to_dataframe|to_table|samples|xyz|head|tail|iloc|loc)":
        "result.to_pandas(), .to_polars(), .to_arrow(), or result.batches() piece by piece",
    r"(to_numpy|array|as_array|__array__)": 'result.to_pandas()[["x", "y", "z"]].to_numpy()',
    r"(transform|predict|apply|fit_transform)": "result.calibration(xyz, temperature)",
    r"(gain|scale|scale_|gain_|k|K|coef_?|offset_?|intercept_?|slope|coefficients|(get_)?param(eter)?s)":
        "result.calibration.gain, .offset and .slope",
    r"(fit|fit_\w+)": "accelcal.calibrate(xyz, rate=100), which finds and judges the still windows itself",
    r"(save|to_csv|to_parquet|to_file|export|dump)": "result.write(FOLDER), accelcal.export(result, to=)",
    r"(to_json|json|to_dict|as_dict)": "result.report, which json.dump can write",
    r"(error|error_mg|mean_error|score|rmse)": "result.calibration_error_mg",
    r"(show|display|figure|html)": "result.plot(), or result.to_html()",
    r"(status|success|ok|good|quality_flag|is_good)": "result.usable, result.outcome and result.cautions",
    r"(enmo|ENMO|mad|MAD|metrics?|activity)": 'accelcal.effect("recording.cwa", epoch=60)',
    r"(info|describe|meta|metadata|header)": 'result.report["recording"], or result.summary()',
}  # fmt: skip
"""The same of attributes of results and calibrations."""

KEYWORDS = {
    "rate": ("fs", "hz", "sf", "sfreq", "freq", "frequency", "sample_rate", "sampling_rate", "samplerate"),
    "timezone": ("tz", "zone", "time_zone"), "unit": ("units",), "start": ("start_time", "begin", "t0"),
    "temperature": ("temp", "temps", "temperatures"), "gyroscope": ("gyro",),
    "output": ("out", "output_dir", "outdir", "outputdir", "out_dir", "output_folder", "save"),
    "source": ("accel", "acc", "acceleration", "xyz", "data", "df", "file", "filename", "path", "recording"),
    "jobs": ("n_jobs", "workers", "num_workers", "processes", "cores"),
    "lsb_per_g": ("scale", "sensitivity", "counts_per_g"), "max_error": ("tolerance", "max_error_mg"),
}  # fmt: skip
"""Keywords of functions, and other packages' names for them."""

ELSEWHERE = {
    "output": "a result writes its files: .write(FOLDER)",
    "jobs": "accelcal.study(FOLDER, OUT, jobs=) works on several recordings at a time",
}
"""What to type for a keyword that the function does not have."""


def _found(hints: dict[str, str], name: str) -> str | None:
    return next((said for pattern, said in hints.items() if re.fullmatch(pattern, name)), None)


def no_such_name(name: str, known: list[str]) -> AttributeError:
    """Return the error of a name that the module has not, with what to type."""
    said = None if name.startswith("_") else _found(HINTS, name) or did_you_mean(name, known)
    return AttributeError(_joined(f"module 'accelcal' has no attribute {name!r}", said), name=name)


def no_such_attribute(kind: str, name: str, of: type) -> AttributeError:
    """Return the error of an attribute that a class has not, with what to type."""
    public = [one for one in dir(of) if not one.startswith("_")]
    said = None if name.startswith("_") else _found(OF_OBJECTS, name) or did_you_mean(name, public)
    return AttributeError(_joined(f"a {kind} has no attribute {name!r}", said), name=name)


def _joined(what: str, said: str | None) -> str:
    asked = not said or said.startswith("did you mean")
    return "; ".join(filter(None, [what, said if asked else f"type {said}"]))


def no_such_option(name: str, known: list[str]) -> TypeError:
    """Return the error of a keyword that a function has not, with the one that was meant."""
    ours = next((one for one, others in KEYWORDS.items() if name.lower() in (one, *others)), "")
    said = f"did you mean {ours!r}?" if ours in known else ELSEWHERE.get(ours) or did_you_mean(name, known)
    return TypeError("; ".join(filter(None, [f"there is no option {name!r}", said])))
