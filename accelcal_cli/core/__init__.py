"""What flows between the rooms: records, errors, clocks. Imports nothing else of the package."""
