"""The command layer: the only layer that knows click, the terminal and exit codes."""
