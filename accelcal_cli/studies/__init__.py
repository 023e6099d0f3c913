"""Studies: calibrate a folder of recordings in parallel and resumably, and sum up."""
