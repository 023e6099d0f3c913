"""The optimizers that exist for comparison, found by listing this folder (`accelcal_cli.optimize`)."""
