"""Parts of the Axivity reader."""
