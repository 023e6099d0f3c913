"""Text files as sources of named columns: encoding, layout, lines, and the parsing of these."""
