"""Names, columns and figures of the parameters."""

from __future__ import annotations

import pytest

from accelcal_cli.core.calibration import PARAMETER_NAMES
from accelcal_cli.core.points import MODELS
from accelcal_cli.devices.table import PARAMETERS
from accelcal_cli.output.words import with_error


def test_parameters_are_in_the_order_of_the_models() -> None:
    """Models name their free parameters by this order."""
    named = {name: one.column for name, one in zip(PARAMETER_NAMES, PARAMETERS, strict=True)}
    assert all(column == name for name, column in named.items() if name.startswith("k_"))
    assert named["oy"] == "offset_y_g" and named["sx"] == "slope_x_g_per_c"
    assert [PARAMETERS[index].name for index in MODELS["6"].free] == [
        "scale_x", "scale_y", "scale_z", "offset_x", "offset_y", "offset_z",
    ]  # fmt: skip


@pytest.mark.parametrize(
    ("value", "error", "text"),
    [
        (3.00234, 0.00278, "+3.0023 +- 0.0028"),
        (-151.04, 0.12, "-151.04 +- 0.12"),
        (5.0, 1.26, "+5.0 +- 1.3"),
        (41.3, 12.2, "+41 +- 12"),
        (412.6, 123.4, "+413 +- 123"),
        (1.0, 1e-12, "+1.000000 +- 0.000000"),
        (1.0, 0.0, "+1.00 +- 0.00"),
    ],
)
def test_an_error_has_two_digits(value: float, error: float, text: str) -> None:
    assert with_error(value, error) == text
