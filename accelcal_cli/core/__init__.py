"""What flows between the layers: records, errors, clocks. Imports nothing else of the package."""
