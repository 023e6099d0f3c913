"""Parts of the GENEActiv reader."""
