"""Parts of the CSV reader."""
