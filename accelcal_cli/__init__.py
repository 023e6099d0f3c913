"""Autocalibration of raw accelerometer (actigraph) recordings by the stillness they contain.

From Python, `import accelcal` (docs/python.md).
"""

from accelcal_cli.core.version import __version__ as __version__
