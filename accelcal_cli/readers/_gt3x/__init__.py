"""Parts of the ActiGraph reader."""
