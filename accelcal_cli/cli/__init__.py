"""The command layer: the only room that knows click, the terminal and exit codes."""
