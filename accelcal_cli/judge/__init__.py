"""The judgement of a calibration by data that its fit did not see."""
