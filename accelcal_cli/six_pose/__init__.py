"""Calibration from known orientations (Bragge et al.): finding the poses, solving, errors."""
