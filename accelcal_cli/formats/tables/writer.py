"""The formats of tables that can be written."""

from __future__ import annotations

from accelcal_cli.formats.tables import csv_writer, hdf5_writer

ENCODER = (csv_writer.ENCODER, hdf5_writer.ENCODER)
