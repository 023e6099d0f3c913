"""The devices of a study: their coefficients over time, how they drift, and which to service."""
