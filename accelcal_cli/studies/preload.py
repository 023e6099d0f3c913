"""All that the first recording would import, which the server that workers are forked from imports once."""

from __future__ import annotations

import zoneinfo

import numpy as np
import pyarrow as pa

import accelcal_cli.output.columns
import accelcal_cli.parquet
import accelcal_cli.pipeline.export
import accelcal_cli.studies.task
from accelcal_cli.core.settings import DEFAULT
from accelcal_cli.formats import load_all
from accelcal_cli.optimize import named_optimizer
from accelcal_cli.output.advice import known_faults
from accelcal_cli.output.report_reading import report_schema
from accelcal_cli.pipeline.outputs import provenance

load_all()
pa.enable_signal_handlers(False)  # as in `formats/tables/text/lines.py`
READY = (
    np.random,
    zoneinfo,
    accelcal_cli.output.columns,
    accelcal_cli.parquet,
    accelcal_cli.pipeline.export,
    accelcal_cli.studies.task,
    named_optimizer(DEFAULT.optimizer),
    report_schema(),
    known_faults(),
    provenance([]),
)
