"""Parts of the evaluations on simulated points."""
