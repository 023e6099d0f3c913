"""Parts shared by the HDF5 readers."""
