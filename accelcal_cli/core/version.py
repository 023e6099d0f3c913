"""The version of the package, which the build reads from here and every report states."""

__version__ = "0.3.0"
