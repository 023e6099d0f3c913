"""Names and columns of the parameters."""

from __future__ import annotations

from accelcal_cli.core.calibration import PARAMETER_NAMES
from accelcal_cli.core.points import MODELS
from accelcal_cli.devices.table import PARAMETERS


def test_parameters_are_in_the_order_of_the_models() -> None:
    """Models name their free parameters by this order."""
    named = {name: one.column for name, one in zip(PARAMETER_NAMES, PARAMETERS, strict=True)}
    assert all(column == name for name, column in named.items() if name.startswith("k_"))
    assert named["oy"] == "offset_y_g" and named["sx"] == "slope_x_g_per_c"
    assert [PARAMETERS[index].name for index in MODELS["6"].free] == [
        "scale_x", "scale_y", "scale_z", "offset_x", "offset_y", "offset_z",
    ]  # fmt: skip
