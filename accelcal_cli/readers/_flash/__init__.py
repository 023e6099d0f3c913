"""Parts of the flash page reader."""
