"""Parts of the raw dump reader."""
