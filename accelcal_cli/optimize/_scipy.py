"""SciPy, where it is installed: only the two general solvers need it."""

from __future__ import annotations

from typing import Any

from accelcal_cli.core.errors import UsageError


def scipy_optimize(optimizer: str) -> Any:
    """The module scipy.optimize.

    Raises:
        UsageError: SciPy is not installed.
    """
    try:
        import scipy.optimize
    except ImportError as error:
        raise UsageError(
            f"optimizer {optimizer} needs SciPy", hint="pip install 'accelcal[methods]'"
        ) from error
    return scipy.optimize
