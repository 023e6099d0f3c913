"""Imported once by the server that workers are forked from: what the first recording would import.

pyarrow imports pandas when it first makes an array.
"""

from __future__ import annotations

import pandas

import accelcal_cli.pipeline.writing
import accelcal_cli.study.work
from accelcal_cli.core.settings import DEFAULT
from accelcal_cli.optimize import named_optimizer
from accelcal_cli.output.report import report_schema
from accelcal_cli.pipeline.provenance import provenance
from accelcal_cli.readers import load_all

load_all()
READY = (
    pandas,
    accelcal_cli.pipeline.writing,
    accelcal_cli.study.work,
    named_optimizer(DEFAULT.optimizer),
    report_schema(),
    provenance([]),
)
