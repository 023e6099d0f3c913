"""The objects that pass between the layers: records, errors, clocks. Imports nothing else of the package."""
