"""Writing results: Parquet, JSON, both complete or not at all."""
